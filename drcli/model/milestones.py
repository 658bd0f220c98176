"""The milestones of a training: checkpoints that did something first or best."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, get_args

from drcli.base.json_record import JsonRecord, SafeInt, Seconds
from drcli.bucket.bucket import ObjectDamaged, find_record
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName, NameText, checkpoint_name
from drcli.records.iteration import IterationRecord
from drcli.records.scores import EvaluationResult

MilestoneKind = Literal["first-lap", "three-laps", "best-lap"]
KINDS: tuple[MilestoneKind, ...] = get_args(MilestoneKind)

THREE = 3


@dataclass(frozen=True)
class Milestone:
    checkpoint: NameText
    laps: SafeInt
    episodes: SafeInt
    progress: float
    best_lap_s: Seconds

    @property
    def name(self) -> CheckpointName:
        return checkpoint_name(self.checkpoint)


@dataclass(frozen=True)
class MilestoneReport:
    """A milestone that was reached."""

    word: Annotated[MilestoneKind, "first-lap, three-laps or best-lap; --checkpoint takes it."]
    checkpoint: Annotated[str, "Name of its checkpoint."]
    laps: Annotated[int, "Clean laps of its evaluation."]
    episodes: Annotated[int, "Episodes of its evaluation."]
    best_lap_s: Annotated[float, "Fastest of the clean laps, simulated seconds."]


@dataclass(frozen=True)
class Milestones(JsonRecord):
    """`best_lap` is of the present stage only, as tracks differ."""

    first_lap: Milestone | None = None
    three_laps: Milestone | None = None
    best_lap: Milestone | None = None
    spaced: list[NameText] = field(default_factory=list)

    def reached(self) -> Iterator[tuple[MilestoneKind, Milestone]]:
        found = zip(KINDS, (self.first_lap, self.three_laps, self.best_lap), strict=True)
        yield from ((kind, milestone) for kind, milestone in found if milestone is not None)

    def with_evaluation(
        self, checkpoint: str, progress: Sequence[float], lap_s: Sequence[float]
    ) -> "Milestones":
        """Evaluations may come in any order (percent, simulated seconds)."""
        if not lap_s or not progress:
            return self
        mean = sum(progress) / len(progress)
        new = Milestone(checkpoint, len(lap_s), len(progress), mean, min(lap_s))
        best = min(filter(None, (self.best_lap, new)), key=_fastest)
        return replace(
            self,
            first_lap=_earlier(self.first_lap, new),
            three_laps=_earlier(self.three_laps, new) if new.laps >= THREE else self.three_laps,
            best_lap=best,
        )

    def of_stage(self, first: int) -> "Milestones":
        """Without a fastest lap from before the stage's first checkpoint."""
        if self.best_lap is None or self.best_lap.name.number >= first:
            return self
        return replace(self, best_lap=None)

    def until(self, newest: CheckpointName) -> "Milestones":
        """Without later ones: a training that went back makes them again."""

        def kept(milestone: Milestone | None) -> Milestone | None:
            return milestone if milestone is not None and _is_before(milestone.name) else None

        def _is_before(name: CheckpointName) -> bool:
            return name == newest or name.number < newest.number

        left = [kept(each) for each in (self.best_lap, self.first_lap, self.three_laps)]
        best, first, three = left
        fastest = min(filter(None, left), key=_fastest, default=None)
        return replace(
            self,
            first_lap=first,
            three_laps=three,
            best_lap=best or fastest,
            spaced=[name for name in self.spaced if _is_before(checkpoint_name(name))],
        )


def _fastest(milestone: Milestone) -> tuple[float, CheckpointName]:
    return milestone.best_lap_s, milestone.name


def _earlier(known: Milestone | None, new: Milestone) -> Milestone:
    return new if known is None or new.name < known.name else known


# The milestones of a model: read, written, worked out from evaluations.


NO_MILESTONES = Milestones()


def read_milestones(model: ModelStore) -> Milestones | None:
    """None if missing, as in version 0.1.0 (see `with_history`).

    Raises:
        ObjectDamaged: It is unreadable.
    """
    return find_record(model.bucket, keys.milestones(model.prefix), Milestones.decode)


def write_milestones(model: ModelStore, milestones: Milestones) -> None:
    model.bucket.put(keys.milestones(model.prefix), milestones.encode())


def with_history(known: Milestones, records: Iterable[IterationRecord]) -> Milestones:
    before: IterationRecord | None = None
    for record in records:
        if record.stage if before is None else not record.compares_with(before):
            known = known.of_stage(record.iteration)
        before = record
        known = known.with_evaluation(
            _evaluated(record), record.evaluation_progress, record.evaluation_lap_s
        )
    return known


def _evaluated(record: IterationRecord) -> str:
    """Where driving and learning overlap, an earlier checkpoint drove."""
    if checkpoint_name(record.checkpoint).number == record.iteration:
        return record.checkpoint
    return str(CheckpointName(record.iteration, max(0, record.total_steps - record.steps)))


def with_results(known: Milestones, results: Iterable[EvaluationResult]) -> Milestones:
    for result in results:
        known = known.with_evaluation(result.checkpoint, result.progress, result.lap_s)
    return known


def readable_milestones(
    model: ModelStore, records: Iterable[IterationRecord]
) -> tuple[Milestones, list[str]]:
    """For readers that never write, filled in from the learning curve; and a sentence on damage."""
    damaged: list[str] = []
    try:
        known = read_milestones(model)
    except ObjectDamaged as error:
        known, damaged = None, [f"{error} {error.remedy}"]
    return with_history(known or NO_MILESTONES, records), damaged
