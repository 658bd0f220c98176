"""The learning curve of a run: one record an iteration, in one object beside the metrics."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from drcli.base.json_record import Misfit, built, parsed
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing

MAY_BE_NAN = (
    *("entropy", "surrogate_loss", "value_loss", "kl"),
    *("steps_per_s", "real_time_factor", "drive_s", "learn_s", "exchange_s"),
)
"""What is unknown before anything is learned, and in a history that was rebuilt."""


@dataclass(frozen=True)
class IterationRecord:
    """One iteration: what was driven with a checkpoint and what was learned from it.

    Attributes:
        iteration: Number of the checkpoint that drove, from 0.
        checkpoint: Its name.
        episodes: Training episodes played.
        steps: Steps learned from.
        total_steps: Steps learned from since the beginning.
        mean_reward: Mean sum of rewards of an episode.
        mean_progress: Mean progress of an episode, percent of a lap.
        full_laps: Episodes that ended with a completed lap.
        best_lap_s: Fastest completed lap, simulated seconds, or None.
        entropy: Mean entropy of the policy in the last epoch, nats.
        surrogate_loss: Mean policy loss of the last epoch; NaN for SAC.
        value_loss: Mean value loss of the last epoch; NaN for SAC.
        kl: Mean divergence from the policy that drove, in the last epoch; NaN for SAC.
        steps_per_s: Steps learned from per second of wall time, driving and learning together.
        real_time_factor: Simulated seconds per second of wall time, all cars together.
        drive_s: Wall time that the slowest worker drove.
        learn_s: Wall time of the update.
        exchange_s: Wall time of the iteration that neither driving nor learning explains.
        elapsed_s: Wall time of training so far, without the time it was stopped.
        evaluation_progress: Progress of each evaluation episode of this checkpoint, percent.
        evaluation_lap_s: Lap times of its completed evaluation laps, simulated seconds.
        actor_loss: SAC's, mean of the last part of the update; None for PPO.
        critic_loss: Mean loss of SAC's two critics, likewise.
        alpha: SAC's temperature, likewise.
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
    entropy: float
    surrogate_loss: float
    value_loss: float
    kl: float
    steps_per_s: float
    real_time_factor: float
    drive_s: float
    learn_s: float
    exchange_s: float
    elapsed_s: float
    evaluation_progress: list[float] = field(default_factory=list)
    evaluation_lap_s: list[float] = field(default_factory=list)
    actor_loss: float | None = None
    critic_loss: float | None = None
    alpha: float | None = None


def fields_of(record: IterationRecord) -> dict[str, Any]:
    """A record as a checkpoint carries it: strict JSON has no word for what is no number."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in asdict(record).items()
    }


def learned_record(fields: Mapping[str, Any]) -> IterationRecord:
    """The record that a checkpoint carries.

    Raises:
        Misfit: It is something else.
    """
    known = {
        name: math.nan if value is None and name in MAY_BE_NAN else value
        for name, value in fields.items()
    }
    return record_of(known)


class History:
    """All iterations of a run. The trainer writes it, everybody may read it."""

    def __init__(self, bucket: Bucket, prefix: str) -> None:
        self._bucket = bucket
        self._key = keys.history(prefix)
        self.records: list[IterationRecord] = read_history(bucket, prefix)

    def restore(self, iteration: int, last: Mapping[str, Any] | None) -> None:
        """Go back to where a checkpoint was published.

        Args:
            iteration: Its number; iterations from this one on are forgotten, for they will be
                repeated.
            last: The fields of the record before, as the checkpoint has them: it is published
                before the record, so a trainer that dies in between leaves only these.
        """
        self.records = [r for r in self.records if r.iteration < iteration]
        if last is not None and last["iteration"] not in {r.iteration for r in self.records}:
            self.add(learned_record(last))

    def add(self, record: IterationRecord) -> None:
        """Append an iteration and publish."""
        self.records.append(record)
        self._write()

    def add_evaluation(self, iteration: int, progress: list[float], lap_s: list[float]) -> None:
        """Note how a checkpoint's evaluation went, and publish."""
        self.records = [
            replace(r, evaluation_progress=progress, evaluation_lap_s=lap_s)
            if r.iteration == iteration
            else r
            for r in self.records
        ]
        self._write()

    def _write(self) -> None:
        text = json.dumps({"iterations": [asdict(record) for record in self.records]})
        self._bucket.put(self._key, text.encode())


def read_history(bucket: Bucket, prefix: str) -> list[IterationRecord]:
    """All iterations so far, oldest first; empty for a model that has none.

    Raises:
        ObjectDamaged: It is something else.
    """
    key = keys.history(prefix)
    try:
        file = parsed(bucket.get(key), with_nan=True)
        if not isinstance(file, dict) or not isinstance(file.get("iterations"), list):
            raise Misfit("it has no list of 'iterations'")
        return [record_of(fields) for fields in file["iterations"]]
    except ObjectMissing:
        return []
    except Misfit as e:
        raise ObjectDamaged(
            f"{bucket.name}/{key} is damaged: {e}.",
            remedy="Stop the training and go on with `dr-start-training --resume`, which rebuilds "
            "it.",
        ) from e


def record_of(fields: Any) -> IterationRecord:
    """An iteration from JSON.

    Raises:
        Misfit: It is something else.
    """
    return built(IterationRecord, fields, nan=MAY_BE_NAN)
