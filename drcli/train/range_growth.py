"""Decides how much of the DR_SIM_ ranges training episodes draw from: DR_SIM_GROW."""

from collections.abc import Sequence
from dataclasses import dataclass

from drcli.records.checkpoint import CheckpointName
from drcli.records.iteration import IterationRecord
from drcli.records.stage import RangesMark

NARROWEST = 0.25
STEP = 0.25

CLEAN = 0.8
"""From this share of clean laps on, the ranges grow."""

LOST = 0.5
"""Below it, they shrink."""


def next_ranges(
    mark: RangesMark, records: Sequence[IterationRecord]
) -> tuple[RangesMark, str] | None:
    """What the checkpoint after these records drives with, and why; None if nothing changes.

    Only what has driven with the present ranges says something. A checkpoint is judged once it is
    evaluated, except in the phase of a teacher, which has no evaluations.
    """
    judged = [
        record
        for record in records
        if _drove(record) >= mark.iteration
        and (record.evaluation_progress or record.phase == "teacher")
    ]
    if not judged:
        return None
    best = _best_of(judged[-1])
    step = STEP if best.share >= CLEAN else -STEP if best.share < LOST else 0.0
    share = min(max(mark.share + step, NARROWEST), 1.0)
    if share == mark.share:
        return None
    verb = "grow" if share > mark.share else "shrink"
    sentence = (
        f"{best.clean} of {best.driven} {best.what} were clean: the ranges of DR_SIM_ settings "
        f"{verb} from {mark.share:.0%} to {share:.0%}."
    )
    return RangesMark(share, records[-1].iteration + 1), sentence


@dataclass(frozen=True)
class _Laps:
    clean: int
    driven: int
    what: str

    @property
    def share(self) -> float:
        return self.clean / max(1, self.driven)


def _best_of(record: IterationRecord) -> _Laps:
    """Of the laps of training and evaluation.

    Those of training have the present ranges, but explore. Those of evaluations have the full
    ranges: alone, they would never let a model meet what it has to learn.
    """
    training = _Laps(record.full_laps, record.episodes, "training laps")
    own = record.all_laps
    if record.second_progress:
        what = f"laps on {record.second_world}"
        evaluation = _Laps(len(record.second_lap_s), len(record.second_progress), what)
    elif own is not None:
        evaluation = _Laps(own.clean, own.driven, "evaluation laps")
    else:
        return training
    return max(evaluation, training, key=lambda laps: laps.share)


def _drove(record: IterationRecord) -> int:
    """Number of the checkpoint whose ranges the training episodes had; -1 if unknown."""
    name = CheckpointName.parse(record.checkpoint)
    return -1 if name is None else name.number
