"""The rows of a comparison's table."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from drcli.analysis.compare_runs import ComparedPair, Comparison

Kind = Literal["count", "percent", "lap", "time", "usd", "number", "steps"]
_USED: tuple[tuple[str, Kind], ...] = (("steps", "steps"), ("wall_s", "time"), ("usd", "usd"))


@dataclass(frozen=True)
class ComparisonRow:
    name: str
    kind: Kind
    values: Sequence[float | None]
    limit: tuple[Kind, float] | None = None
    unknown: str | None = None


@dataclass(frozen=True)
class IntervalRow:
    """A difference of two trainings, with its interval."""

    name: str
    unit: str
    difference: float
    low: float
    high: float
    beyond_chance: bool


def comparison_rows(report: "Comparison") -> Iterator[ComparisonRow]:
    runs = report.runs
    yield ComparisonRow("iterations", "count", [run.iterations for run in runs])
    yield ComparisonRow("steps", "count", [run.steps for run in runs])
    yield ComparisonRow("wall time", "time", [run.wall_s for run in runs])
    yield ComparisonRow("cost", "usd", [run.cost_usd for run in runs])
    yield ComparisonRow("clean laps", "count", [run.complete_laps for run in runs])
    yield ComparisonRow("best lap", "lap", [run.best_lap_s for run in runs])
    yield ComparisonRow("late progress", "percent", [run.late_progress for run in runs])
    yield ComparisonRow("late clean laps", "percent", [run.late_lap_share for run in runs])
    yield ComparisonRow("late lap time", "lap", [run.late_lap_s for run in runs])
    yield ComparisonRow("late reward", "number", [run.late_reward for run in runs])
    if any(run.evaluated_laps for run in runs):
        yield ComparisonRow("evaluation laps", "count", [run.evaluated_laps for run in runs])
        yield ComparisonRow("of them clean", "count", [run.evaluated_clean for run in runs])
        yield ComparisonRow("resets", "count", [run.evaluated_resets for run in runs])
        yield ComparisonRow("median clean lap", "lap", [run.evaluated_median_s for run in runs])
    for place, goal in enumerate(runs[0].goals):
        reached = [run.goals[place]["steps"] for run in runs]
        if any(value is not None for value in reached):
            name = f"{goal['progress']:.0f} % after"
            yield ComparisonRow(name, "steps", reached, unknown="never")
    for used, kind in _USED:
        equal = report.at_equal.get(used)
        if equal is not None:
            yield ComparisonRow("at", "percent", equal["progress"], limit=(kind, equal["limit"]))


def interval_rows(pair: "ComparedPair") -> Iterator[IntervalRow]:
    for name, found, unit in (
        ("progress", pair.progress, "%"),
        ("clean laps", pair.lap_share, "of 100"),
        ("lap time", pair.lap_s, "s"),
        ("reward", pair.reward, ""),
    ):
        if found is not None:
            yield IntervalRow(
                name,
                unit,
                found["difference"],
                found["low"],
                found["high"],
                found["beyond_chance"],
            )
