"""The milestones of a training: checkpoints that did something first or best."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from drcli.base.json_record import JsonRecord
from drcli.exchange.checkpoint import CheckpointName, checkpoint_name

MilestoneKind = Literal["first-lap", "three-laps", "best-lap"]
KINDS: tuple[MilestoneKind, ...] = get_args(MilestoneKind)

THREE = 3


@dataclass(frozen=True)
class Milestone:
    checkpoint: str
    laps: int
    episodes: int
    progress: float
    best_lap_s: float

    def __post_init__(self) -> None:
        checkpoint_name(self.checkpoint)

    @property
    def name(self) -> CheckpointName:
        return checkpoint_name(self.checkpoint)


@dataclass(frozen=True)
class Milestones(JsonRecord):
    """`best_lap` is of the present stage only, as tracks differ."""

    first_lap: Milestone | None = None
    three_laps: Milestone | None = None
    best_lap: Milestone | None = None
    spaced: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        for name in self.spaced:
            checkpoint_name(name)

    def of_kind(self, kind: MilestoneKind) -> Milestone | None:
        found = {
            "first-lap": self.first_lap,
            "three-laps": self.three_laps,
            "best-lap": self.best_lap,
        }
        return found[kind]

    def reached(self) -> Iterator[tuple[MilestoneKind, Milestone]]:
        for kind in KINDS:
            milestone = self.of_kind(kind)
            if milestone is not None:
                yield kind, milestone

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
