"""The record of one iteration, and `history.json` with all of them."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

from drcli.base.json_record import JsonRecord, MaybeNan, RecordError, parse_json
from drcli.exchange.laps import Laps


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

    iteration: int
    checkpoint: str
    episodes: int
    steps: int
    total_steps: int
    mean_reward: float
    mean_progress: float
    full_laps: int
    best_lap_s: float | None
    entropy: MaybeNan = math.nan
    surrogate_loss: MaybeNan = math.nan
    value_loss: MaybeNan = math.nan
    kl: MaybeNan = math.nan
    steps_per_s: MaybeNan = math.nan
    real_time_factor: MaybeNan = math.nan
    drive_s: MaybeNan = math.nan
    learn_s: MaybeNan = math.nan
    exchange_s: MaybeNan = math.nan
    elapsed_s: float
    evaluation_progress: list[float] = field(default_factory=list)
    evaluation_lap_s: list[float] = field(default_factory=list)
    confirmation_progress: list[float] = field(default_factory=list)
    confirmation_lap_s: list[float] = field(default_factory=list)
    actor_loss: float | None = None
    critic_loss: float | None = None
    alpha: float | None = None
    reward_errors: int = 0
    discarded: int = 0
    evaluation_steering_per_m: float | None = None
    stage: str = ""
    second_world: str = ""
    second_progress: list[float] = field(default_factory=list)
    second_lap_s: list[float] = field(default_factory=list)
    world: str = ""
    phase: str = ""
    imitation_loss: float | None = None

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
    fields = asdict(record)
    for name in LEFT_OUT_IF_EMPTY:
        if not fields[name]:
            del fields[name]
    return json.dumps(fields).encode()


def encode_history(records: Sequence[IterationRecord]) -> bytes:
    return HISTORY_HEAD + SEPARATOR.join(map(encode_iteration, records)) + HISTORY_END


def decode_history(data: bytes) -> list[IterationRecord]:
    file = parse_json(data, with_nan=True)
    if not isinstance(file, dict) or not isinstance(file.get("iterations"), list):
        raise RecordError("it has no list of 'iterations'")
    return [IterationRecord.from_json(fields) for fields in file["iterations"]]
