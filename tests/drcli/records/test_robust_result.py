"""The number of a robust evaluation, worked by hand."""

from drcli.records.evaluation_task import RobustCell, RobustResult, TaskOutcome


def cell(axis: str, level: str, completed: int, progress: float) -> RobustCell:
    return RobustCell(axis, level, 4, completed, progress, None)


def result(*cells: RobustCell) -> RobustResult:
    return RobustResult("model", "8.ckpt", "reinvent_base", 0, list(cells), 1.0)


def test_every_axis_counts_the_same_however_many_levels_it_has():
    found = result(
        cell("none", "none", 4, 100.0),
        cell("light", "x 0.5", 2, 80.0),
        cell("light", "x 1.5", 0, 40.0),
        cell("light", "x 2", 0, 0.0),
        cell("grip", "x 0.5", 0, 20.0),
    )

    assert found.axis_scores == {"none": 100.0, "light": 40.0, "grip": 20.0}
    assert found.robust_score == 53.33  # (100 + 40 + 20) / 3


def test_a_model_is_broken_by_what_halves_its_laps():
    found = result(
        cell("none", "none", 4, 100.0),
        cell("light", "x 0.5", 3, 90.0),
        cell("latency", "0.1 s", 2, 60.0),
    )

    assert found.broken_by == ["latency 0.1 s"]


def test_nothing_breaks_a_model_that_completes_no_lap_anyway():
    assert result(cell("none", "none", 0, 30.0), cell("grip", "x 2", 0, 9.0)).broken_by == []


def test_the_outcome_of_a_task_comes_back_from_its_file():
    outcome = TaskOutcome(robust=result(cell("none", "none", 4, 100.0)), notes=["moved"])

    assert TaskOutcome.decode(outcome.encode()) == outcome
