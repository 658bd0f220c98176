"""The record of one iteration, and `history.json` with all of them."""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from statistics import median
from typing import TYPE_CHECKING

from drcli.base.installation import lazy_imports
from drcli.base.json_record import JsonRecord, SafeInt, Seconds, decode_json

with lazy_imports():
    import numpy as np

# What a sample of laps says about a checkpoint.
#
# A *clean lap* is completed without violation, reset or penalty, as is each completed lap of an
# evaluation during training. A *finished lap* is completed, maybe with resets.


Z_95 = 1.959964
CONFIRMING_LAPS = 40
"""From new starts: is a checkpoint as good as it seems?"""

CONFIRMING_CLEAN = 38


@dataclass(frozen=True)
class Laps:
    """Laps of one checkpoint; `clean_s` are simulated seconds."""

    driven: int
    clean_s: Sequence[float]

    @property
    def clean(self) -> int:
        return len(self.clean_s)

    @property
    def median_s(self) -> float | None:
        return median(self.clean_s) if self.clean_s else None

    @property
    def p90_s(self) -> float | None:
        """Nine of ten clean laps do not exceed it."""
        return sorted(self.clean_s)[math.ceil(0.9 * self.clean) - 1] if self.clean_s else None

    @property
    def fastest_s(self) -> float | None:
        return min(self.clean_s, default=None)

    @property
    def slowest_s(self) -> float | None:
        return max(self.clean_s, default=None)

    @property
    def interval(self) -> tuple[float, float]:
        """Of the true share of clean laps, 95 % confidence."""
        return share_interval(self.clean, self.driven)

    def within(self, most_s: float | None) -> "Laps":
        if most_s is None:
            return self
        return Laps(self.driven, [lap_s for lap_s in self.clean_s if lap_s <= most_s])

    def __add__(self, other: "Laps") -> "Laps":
        return Laps(self.driven + other.driven, [*self.clean_s, *other.clean_s])

    def __str__(self) -> str:
        """Such as "39 of 40 laps clean, median 7.61 s, slowest 7.93 s"."""
        words = f"{self.clean} of {self.driven} {'lap' if self.driven == 1 else 'laps'} clean"
        if self.clean == 1:
            return f"{words}, {self.clean_s[0]:.2f} s"
        if self.clean:
            words += f", median {self.median_s:.2f} s, slowest {self.slowest_s:.2f} s"
        return words


def is_clean_lap(finished: bool, *faults: float | None) -> bool:
    """Finished without `faults`: violations, resets, penalty (None: not recorded)."""
    return finished and not any(faults)


def laps_summary(laps: Laps, *, resets: int, finished: int, best: str) -> str:
    """Such as "2 of 3 laps clean (1 reset), 3 finished, best 7.73 s"."""
    words = f"{laps.clean} of {laps.driven} {'lap' if laps.driven == 1 else 'laps'} clean"
    if resets:
        words += f" ({counted_resets(resets)})"
    if finished > laps.clean:
        words += f", {finished} finished"
    if best:
        words += f", {'best' if laps.clean else 'the fastest in'} {best}"
    return words


def lap_time(
    lap_s: float,
    penalty_s: float | None,
    resets: int,
    clock: Callable[[float], str] | None = None,
) -> str:
    """Such as "7.80 s", or "12.80 s = 7.80 driven + 5.00 penalty, 1 reset".

    `lap_s` includes penalties.
    """
    words = f"{lap_s:.2f} s" if clock is None else clock(lap_s)
    if penalty_s:
        driven_s = lap_s - penalty_s
        driven = f"{driven_s:.2f}" if clock is None else clock(driven_s)
        words += f" = {driven} driven + {penalty_s:.2f} penalty"
    return f"{words}, {counted_resets(resets)}" if resets else words


def counted_resets(count: int) -> str:
    return f"{count} reset{'s' * (count != 1)}"


def paired_p(differences: Iterable[int]) -> float:
    """Probability of so large a sum of differences, or larger, if each sign were a coin flip.

    The exact two-sided permutation test for pairs of whole numbers; for -1, 0 and 1, McNemar's.
    """
    flipped = [difference for difference in differences if difference]
    sizes = sorted(map(abs, flipped))
    chances = np.zeros(sum(sizes) + 1)  # of each sum of those that are positive
    chances[0], most = 1.0, 0
    for size in sizes:
        most += size
        chances[: most + 1] /= 2.0
        chances[size : most + 1] += chances[: most + 1 - size].copy()
    # A sum of all is as small as this one if at most so much of it is positive.
    fewest = (most - abs(sum(flipped))) // 2
    return min(1.0, 2.0 * float(chances[: fewest + 1].sum()))


def share_interval(count: int, of: int, z: float = Z_95) -> tuple[float, float]:
    """Wilson's score interval of a share, within [0, 1].

    Unlike the usual one, right for few trials and shares near 0 and 1.
    """
    share, square = count / of, z * z / of
    middle = share + square / 2.0
    half = math.sqrt(square * (share * (1.0 - share) + square / 4.0))
    low, high = (middle - half) / (1.0 + square), (middle + half) / (1.0 + square)
    # At the ends, the formula gives them exactly but for rounding.
    return 0.0 if count == 0 else low, 1.0 if count == of else high


if TYPE_CHECKING:
    MaybeNan = float
else:
    MaybeNan = float | None  # in JSON


@dataclass(frozen=True, kw_only=True)
class IterationRecord(JsonRecord):
    """One iteration: what a checkpoint drove and what was learned from it.

    Unknown numbers are NaN. The losses of PPO are NaN for SAC.

    Attributes:
        iteration: Number of the checkpoint that was improved, from 0.
        checkpoint: Name of the one that drove; where driving and learning overlap, the one before.
        episodes: Training episodes driven.
        steps: Steps learned from.
        total_steps: Steps learned from since the beginning.
        mean_reward: Mean total reward of an episode.
        mean_progress: Mean progress of an episode, percent of a lap.
        full_laps: Episodes with a completed lap.
        best_lap_s: Fastest completed lap, simulated seconds; None without one.
        entropy: Mean entropy of the policy in the last epoch, nats.
        surrogate_loss: Mean policy loss of the last epoch.
        value_loss: Mean value loss of the last epoch.
        kl: Mean divergence from the policy that drove, in the last epoch.
        steps_per_s: Steps learned from per second of driving and learning.
        real_time_factor: Simulated seconds per second of wall time, all cars together.
        drive_s: Wall time of the slowest worker.
        learn_s: Wall time of the update.
        exchange_s: Wall time of neither driving nor learning.
        elapsed_s: Wall time of training so far, without stops.
        evaluation_progress: Progress of each evaluation episode of the checkpoint of this number,
            percent.
        evaluation_lap_s: Times of its completed evaluation laps, simulated seconds.
        confirmation_progress: Progress of each episode that it drove again, from other starts,
            because its evaluation was good enough to end the training or to become the best.
        confirmation_lap_s: Times of the completed laps of these, simulated seconds.
        actor_loss: Actor loss of SAC, mean of the last part of the update; None for PPO.
        critic_loss: Mean loss of the two critics of SAC, likewise.
        alpha: Temperature of SAC, likewise.
        reward_errors: Calls of the reward function that failed and were counted.
        discarded: Episodes that the reward function declared broken, not in `episodes`.
        evaluation_steering_per_m: How often the steering changed its side in each metre of the
            evaluation; None without one.
        stage: Stage of the training; empty without a curriculum.
        second_world: Track of the second evaluation, DR_TRAIN_EVAL_WORLD; empty without one.
        second_progress: Progress of each evaluation episode there, percent.
        second_lap_s: Times of completed laps there, simulated seconds.
        world: Track of the first worker, which evaluates; empty in histories of version 0.1.0.
        phase: Phase of a training with a teacher, else empty.
        imitation_loss: Mean difference of the student's actions from its teacher's, in the last
            part of an update of the phase `distillation`; else None.
    """

    iteration: SafeInt
    checkpoint: str
    episodes: SafeInt
    steps: SafeInt
    total_steps: SafeInt
    mean_reward: float
    mean_progress: float
    full_laps: SafeInt
    best_lap_s: Seconds | None
    entropy: MaybeNan = math.nan
    surrogate_loss: MaybeNan = math.nan
    value_loss: MaybeNan = math.nan
    kl: MaybeNan = math.nan
    steps_per_s: MaybeNan = math.nan
    real_time_factor: MaybeNan = math.nan
    drive_s: MaybeNan = math.nan
    learn_s: MaybeNan = math.nan
    exchange_s: MaybeNan = math.nan
    elapsed_s: Seconds
    evaluation_progress: list[float] = field(default_factory=list)
    evaluation_lap_s: list[Seconds] = field(default_factory=list)
    confirmation_progress: list[float] = field(default_factory=list)
    confirmation_lap_s: list[Seconds] = field(default_factory=list)
    actor_loss: float | None = None
    critic_loss: float | None = None
    alpha: float | None = None
    reward_errors: SafeInt = 0
    discarded: SafeInt = 0
    evaluation_steering_per_m: float | None = None
    stage: str = ""
    second_world: str = ""
    second_progress: list[float] = field(default_factory=list)
    second_lap_s: list[Seconds] = field(default_factory=list)
    world: str = ""
    phase: str = ""
    imitation_loss: float | None = None

    def __post_init__(self) -> None:
        unknown = [name for name in _MAYBE_NAN if getattr(self, name) is None]
        vars(self).update(dict.fromkeys(unknown, math.nan))

    def compares_with(self, other: "IterationRecord") -> bool:
        """Same stage and track, as far as known."""
        known = self.world and other.world
        return self.stage == other.stage and (not known or self.world == other.world)

    def continues(self, other: "IterationRecord") -> bool:
        """Same stage, track and phase."""
        return self.phase == other.phase and self.compares_with(other)

    @property
    def is_own_driving(self) -> bool:
        """The camera policy drove and learns from its rewards."""
        return self.phase in ("", "ppo")

    @property
    def evaluation(self) -> Laps | None:
        """Without confirming laps."""
        return _laps(self.evaluation_progress, self.evaluation_lap_s)

    @property
    def confirmation(self) -> Laps | None:
        """The laps driven again."""
        return _laps(self.confirmation_progress, self.confirmation_lap_s)

    @property
    def all_laps(self) -> Laps | None:
        """On the training track."""
        first, again = self.evaluation, self.confirmation
        return first if first is None or again is None else first + again


_MAYBE_NAN = [item.name for item in fields(IterationRecord) if item.type is MaybeNan]


def _laps(progress: Sequence[float], lap_s: Sequence[float]) -> Laps | None:
    return Laps(len(progress), lap_s) if progress else None


HISTORY_HEAD, HISTORY_END = b'{"iterations": [', b"]}"
"""What is before and after the records in the file `history.json`."""

EVALUATION_FIELDS = (
    "evaluation_progress",
    "evaluation_lap_s",
    "evaluation_steering_per_m",
    "confirmation_progress",
    "confirmation_lap_s",
    "second_world",
    "second_progress",
    "second_lap_s",
)
LEFT_OUT_IF_EMPTY = (
    "confirmation_progress",
    "confirmation_lap_s",
    "stage",
    "second_world",
    "second_progress",
    "second_lap_s",
    "world",
    "phase",
    "imitation_loss",
)
SEPARATOR = b", "


def encode_iteration(record: IterationRecord) -> bytes:
    """May contain NaN, as Python's JSON does."""
    values = record.to_json().items()
    kept = {name: value for name, value in values if value or name not in LEFT_OUT_IF_EMPTY}
    return json.dumps(kept).encode()


def encode_history(records: Sequence[IterationRecord]) -> bytes:
    return HISTORY_HEAD + SEPARATOR.join(map(encode_iteration, records)) + HISTORY_END


def decode_history(data: bytes) -> list[IterationRecord]:
    return decode_json(_History, _strict(data)).iterations


def decode_iteration(data: bytes) -> IterationRecord:
    return decode_json(IterationRecord, _strict(data))


@dataclass(frozen=True)
class _History:
    iterations: list[IterationRecord]


def _strict(data: bytes) -> bytes:
    for unknown in (b"NaN", b"Infinity", b"-Infinity"):
        data = data.replace(b'": ' + unknown, b'": null')
    return data
