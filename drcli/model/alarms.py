"""Sees in the learning curve that a training goes wrong, before its completion falls."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

from drcli.model.history import collapse
from drcli.records.iteration import IterationRecord

ENTROPY_WINDOW, ENTROPY_PAST = 5, 50
"""Iterations over which the entropy is averaged, and in which its lowest mean is looked for."""

ENTROPY_RISE = 0.2
"""Nats above the lowest mean. Fourteen healthy trainings here stayed within 0.05."""

ENTROPY_NEAR = 0.05
ENTROPY_SINCE = 8
REWARD_WINDOW = 13
REWARD_JUMP = 0.4
"""Between iterations, as a share of the mean reward. Healthy trainings: 0.17 to 0.30."""

REWARD_TURNS = 8
"""Up and down in that window, of at most 11."""

REWARD_GAIN = 0.15
"""Share of all jumps left as a change; more is progress."""

STEERING_PER_M = 2.0
"""Changes of side. Calm models here made 0.15 to 0.4, usual ones 0.9 to 1.6."""

STEERING_WINDOW = 5
CONVERGED_OVER, CONVERGED_GAP, CONVERGED_PROGRESS = 5, 5.0, 95.0
"""Evaluations that are compared with the training, the largest gap between the two, and the least
progress of the evaluations, in percent of a lap."""

STEERING_PROGRESS = 50.0
"""Mean percent of these evaluations; a beginner has to zigzag."""


@dataclass(frozen=True)
class Alarm:
    """Something that goes wrong (a part of a sentence), and what helps."""

    subject: str
    text: str
    remedy: str


def alarms(records: Sequence[IterationRecord], best: str | None) -> list[Alarm]:
    found = []
    fallen = collapse(records, best)
    if fallen is not None:
        found.append(collapsed(fallen))
    return [*found, *trends(records)]


@dataclass(frozen=True)
class Convergence:
    """How near training and evaluation are to each other, by the newest evaluated iterations.

    Training episodes draw their actions, evaluations take the likeliest one. They meet when the
    policy has become sure.
    """

    training: Annotated[float, "Mean progress of the training episodes, percent."]
    evaluation: Annotated[float, "Mean progress of the evaluation episodes, percent."]
    reached: Annotated[bool, "Whether they have met, near complete laps."]

    @property
    def gap(self) -> float:
        """How much further evaluations get, percent of a lap."""
        return self.evaluation - self.training


def convergence(records: Sequence[IterationRecord]) -> Convergence | None:
    evaluated = [r for r in _of_stage(records) if r.evaluation_progress][-CONVERGED_OVER:]
    if len(evaluated) < CONVERGED_OVER:
        return None
    training = sum(record.mean_progress for record in evaluated) / CONVERGED_OVER
    evaluation = (
        sum(sum(r.evaluation_progress) / len(r.evaluation_progress) for r in evaluated)
        / CONVERGED_OVER
    )
    met = abs(evaluation - training) <= CONVERGED_GAP and evaluation >= CONVERGED_PROGRESS
    return Convergence(training, evaluation, met)


def collapsed(text: str) -> Alarm:
    return Alarm(
        "collapse",
        text,
        "Stop, and start again from the best checkpoint with a lower `lr`, or let the training do "
        "that itself with DR_TRAIN_MAX_ROLLBACKS=2.",
    )


def trends(records: Sequence[IterationRecord]) -> list[Alarm]:
    """Alarms that need only the newest 50 iterations, of the newest stage."""
    records = _of_stage(records[-ENTROPY_PAST:])
    checks: list[Callable[[Sequence[IterationRecord]], Alarm | None]] = [_steering_zigzags]
    if not records or records[-1].is_own_driving:  # a teacher has hyperparameters of its own
        checks = [_entropy_rises, _reward_zigzags, *checks]
    found = (check(records) for check in checks)
    return [alarm for alarm in found if alarm is not None]


def _entropy_rises(records: Sequence[IterationRecord]) -> Alarm | None:
    if _is_sac(records):
        return None
    entropy = [record.entropy for record in records if not math.isnan(record.entropy)]
    means = _means(entropy, ENTROPY_WINDOW)
    if len(means) <= ENTROPY_SINCE:
        return None
    lowest = min(means)
    low = max(n for n, mean in enumerate(means) if mean <= lowest + ENTROPY_NEAR)
    since = len(means) - 1 - low
    goes_on = means[-1] > means[-min(ENTROPY_WINDOW, len(means))]
    if since < ENTROPY_SINCE or means[-1] < lowest + ENTROPY_RISE or not goes_on:
        return None
    return Alarm(
        "entropy",
        f"the entropy rises, from {lowest:.2f} to {means[-1]:.2f} in {since} iterations: the "
        "policy becomes less sure",
        "Lower `lr` or `beta_entropy`, and check that the reward pays for what the car should do.",
    )


def _is_sac(records: Sequence[IterationRecord]) -> bool:
    return any(record.actor_loss is not None for record in records)


def _reward_zigzags(records: Sequence[IterationRecord]) -> Alarm | None:
    """PPO only: an iteration of SAC may be one episode."""
    if _is_sac(records):
        return None
    rewards = [record.mean_reward for record in records[-REWARD_WINDOW:]]
    if len(rewards) < REWARD_WINDOW:
        return None
    jumps = [after - before for before, after in pairwise(rewards)]
    path = sum(map(abs, jumps))
    mean = sum(map(abs, rewards)) / len(rewards)
    turns = sum(one * other < 0.0 for one, other in pairwise(jumps))
    jump = path / len(jumps)
    if jump <= REWARD_JUMP * mean or turns < REWARD_TURNS:
        return None
    if abs(rewards[-1] - rewards[0]) > REWARD_GAIN * path:
        return None
    return Alarm(
        "reward",
        f"the reward goes up and down by {100.0 * jump / mean:.0f} % from iteration to iteration "
        "and does not grow",
        "Lower `lr` to a third, or raise `num_episodes_between_training`.",
    )


def _steering_zigzags(records: Sequence[IterationRecord]) -> Alarm | None:
    driven = [
        (record.evaluation_steering_per_m, sum(progress) / len(progress))
        for record in records[-2 * STEERING_WINDOW :]
        if record.evaluation_steering_per_m is not None and (progress := record.evaluation_progress)
    ][-STEERING_WINDOW:]
    if len(driven) < STEERING_WINDOW:
        return None
    per_m, percent = (sum(each) / len(driven) for each in zip(*driven, strict=True))
    if per_m <= STEERING_PER_M or percent < STEERING_PROGRESS:
        return None
    return Alarm(
        "steering",
        f"the car zigzags: its steering changes the side {per_m:.1f} times in a metre",
        "Reward less steering, or lower `discount_factor`.",
    )


def _of_stage(records: Sequence[IterationRecord]) -> Sequence[IterationRecord]:
    return [record for record in records if record.continues(records[-1])]


def _means(values: Sequence[float], window: int) -> list[float]:
    ends = range(window, len(values) + 1)
    return [sum(values[end - window : end]) / window for end in ends]
