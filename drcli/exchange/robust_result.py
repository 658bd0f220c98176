"""How a model drives under each disturbance, and one number."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from drcli.base.json_record import JsonRecord

NOMINAL_AXIS = "none"


@dataclass(frozen=True)
class RobustCell(JsonRecord):
    """All trials under one level of one disturbance.

    Attributes:
        axis: What is disturbed, such as "latency".
        level: How far, such as "0.1 s".
        trials: Laps tried, each from another start.
        completed: Laps completed without leaving the track or crashing.
        progress: Mean percent of the lap before the first violation.
        lap_s: Mean time of completed laps, simulated seconds; None without one.
        ended_by: How most other trials ended, such as "Off track"; empty without others.
    """

    axis: str
    level: str
    trials: int
    completed: int
    progress: float
    lap_s: float | None
    ended_by: str = ""


@dataclass(frozen=True)
class RobustResult(JsonRecord):
    """A robust evaluation of one model on one track.

    Attributes:
        prefix: Model prefix in the bucket.
        checkpoint: Name of the checkpoint or file that drove.
        world: The track.
        seed: The same seed gives the same trials.
        cells: Axis by axis, from the nominal trials on.
        seconds: How long the driving took.
    """

    prefix: str
    checkpoint: str
    world: str
    seed: int
    cells: list[RobustCell]
    seconds: float

    @property
    def axis_scores(self) -> dict[str, float]:
        """Mean progress over the levels, percent."""
        axes = dict.fromkeys(cell.axis for cell in self.cells)
        return {
            axis: round(fmean(cell.progress for cell in self.cells if cell.axis == axis), 2)
            for axis in axes
        }

    @property
    def robust_score(self) -> float:
        """0 to 100: mean of the axes' scores."""
        return robust_score(self.cells)

    @property
    def broken_by(self) -> list[str]:
        """Levels with at most half as many completed laps as without disturbance."""
        nominal = [cell for cell in self.cells if cell.axis == NOMINAL_AXIS]
        share = fmean(cell.completed / cell.trials for cell in nominal) if nominal else 0.0
        return [
            f"{cell.axis} {cell.level}"
            for cell in self.cells
            if share > 0.0 and cell.completed / cell.trials <= share / 2
        ]


def robust_score(cells: Sequence[RobustCell]) -> float:
    """Mean over axes of mean progress over levels, 0 to 100."""
    axes: dict[str, list[float]] = {}
    for cell in cells:
        axes.setdefault(cell.axis, []).append(cell.progress)
    return round(fmean(fmean(levels) for levels in axes.values()), 2)
