"""Estimates a training from measured rates."""

from dataclasses import dataclass
from typing import Literal

from drcli.benchmark.bucket_speed import BucketSpeed
from drcli.benchmark.work_order import Rates, Ready

Part = Literal["driving", "learning", "bucket"]

ITERATION_STEPS = 2000
"""20 episodes over a third of `reinvent_base`."""

FIRST_LAP_STEPS = (418, 1878, 4266)
"""Least, median and most until a checkpoint completed an evaluation lap, shipped files, 20 seeds.
Source: docs/benchmarks.md.
"""

FIRST_ITERATION_STEPS = 750
REQUESTS = 14
"""Those that somebody waits for in an iteration."""

POLL_S = 0.1
"""How late pointers are noticed, per iteration."""

EVALUATION_SHARE = 1.1
"""For DR_TRAIN_EVAL_SHARE, a twentieth of all time."""


@dataclass(frozen=True)
class TrainingEstimate:
    """What a training would do with nothing else on the machine.

    Attributes:
        training_steps_per_s: Steps driven, sent and learned from per second.
        driving_s: Time of driving an iteration of `ITERATION_STEPS` steps.
        learning_s: Time of its update.
        bucket_s: Time that its exchange through the bucket adds; 0 if unmeasured.
        limited_by: What takes longest: driving, learning or bucket.
        limiting_share: Its share of an iteration.
    """

    training_steps_per_s: float
    driving_s: float
    learning_s: float
    bucket_s: float
    limited_by: Part
    limiting_share: float


def estimate(ready: Ready, rates: Rates, bucket: BucketSpeed | None) -> TrainingEstimate:
    parts = _parts(ITERATION_STEPS, ready, rates, bucket)
    total_s = _total_s(parts, overlaps=ready.overlaps)
    limit = max(parts, key=lambda part: parts[part])
    return TrainingEstimate(
        training_steps_per_s=ITERATION_STEPS / total_s,
        driving_s=parts["driving"],
        learning_s=parts["learning"],
        bucket_s=parts["bucket"],
        limited_by=limit,
        limiting_share=min(1.0, parts[limit] / total_s),
    )


def first_lap_s(
    ready: Ready, rates: Rates, bucket: BucketSpeed | None
) -> tuple[float, float, float]:
    parts = _parts(FIRST_ITERATION_STEPS, ready, rates, bucket)
    iteration_s = _total_s(parts, overlaps=ready.overlaps)
    least, median, most = (
        ready.prepared_s + steps / FIRST_ITERATION_STEPS * iteration_s for steps in FIRST_LAP_STEPS
    )
    return least, median, most


def _parts(steps: int, ready: Ready, rates: Rates, bucket: BucketSpeed | None) -> dict[Part, float]:
    exchange_s = 0.0
    if bucket is not None:
        megabytes = (steps * rates.step_bytes + ready.weight_bytes) / 1e6
        transfer_s = megabytes / bucket.put_mb_per_s + megabytes / bucket.get_mb_per_s
        exchange_s = transfer_s + REQUESTS * bucket.request_ms / 1000 + POLL_S
    return {
        "driving": EVALUATION_SHARE * steps / rates.driving_steps_per_s,
        "learning": steps * ready.epochs / rates.learning_samples_per_s,
        "bucket": exchange_s,
    }


def _total_s(parts: dict[Part, float], *, overlaps: bool) -> float:
    if overlaps:
        return max(parts["driving"], parts["learning"]) + parts["bucket"]
    return sum(parts.values())
