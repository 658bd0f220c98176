"""Compares trainings: curves, cost, files and statistical differences."""

import difflib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from drcli.analysis.bootstrap import Difference, compare_means
from drcli.analysis.plain_values import plain
from drcli.analysis.run import Run
from drcli.analysis.spans import Numbers

LATE_SHARE, LATE_LEAST, LATE_MOST = 0.2, 5, 30
GOALS = (25.0, 50.0, 75.0)
"""Percent of mean progress."""

SMOOTH = 3
_DIFF_LINES = 400


@dataclass(frozen=True)
class ComparedRun:
    """One of the trainings.

    Attributes:
        model: Its name.
        origin: Where it was read.
        world: Its track; None if unknown.
        iterations: Their number.
        episodes: Training episodes.
        steps: Steps of all iterations.
        wall_s: Wall time of all iterations; None if unknown.
        machine_hours: Of all starts; None if unknown.
        cost_usd: What they cost; None if unknown.
        complete_laps: Training episodes that were complete laps; all of them are clean.
        best_lap_s: The fastest; None without one.
        late_iterations: How many of the newest iterations the next four are of.
        late_reward: Mean reward of an episode.
        late_progress: Mean progress, percent.
        late_lap_share: Share of complete laps, percent.
        late_lap_s: Mean lap time; None without a lap.
        first_lap_steps: Steps until the iteration with the first complete lap; None without one.
        goals: For each of GOALS, steps, wall time and money until it was reached.
        curve: For each iteration: steps, wall_s and usd until its end, reward, progress, mean lap
            time (lap_s) and mean progress of its evaluation (eval_progress).
        evaluated_laps: Laps of the newest evaluation on its own; None without one.
        evaluated_clean: How many of them are clean: without a reset and without a penalty.
        evaluated_resets: How often the car was put back in them.
        evaluated_median_s: Median time of the clean ones; None without one.
    """

    model: str
    origin: str
    world: str | None
    iterations: int
    episodes: int
    steps: int
    wall_s: float | None
    machine_hours: float | None
    cost_usd: float | None
    complete_laps: int
    best_lap_s: float | None
    late_iterations: int
    late_reward: float | None
    late_progress: float | None
    late_lap_share: float | None
    late_lap_s: float | None
    first_lap_steps: int | None
    goals: list[dict[str, Any]]
    curve: dict[str, list[float | None]]
    evaluated_laps: int | None = None
    evaluated_clean: int | None = None
    evaluated_resets: int | None = None
    evaluated_median_s: float | None = None


@dataclass(frozen=True)
class ComparedPair:
    """How a training differs from the first one.

    Attributes:
        model: Its name.
        progress: Difference of the mean progress of the newest iterations, percent of a lap.
        lap_share: Of the share of complete laps, percent.
        lap_s: Of the mean lap time, seconds.
        reward: Of the mean reward; None if the reward functions differ or are not known.
        sentence: What is larger than chance, in words.
        files: The difference of each file, in the form of `diff -u`; empty where they are equal.
        same_reward: Whether both reward functions are known and equal.
    """

    model: str
    progress: dict[str, Any] | None
    lap_share: dict[str, Any] | None
    lap_s: dict[str, Any] | None
    reward: dict[str, Any] | None
    sentence: str
    files: dict[str, str]
    same_reward: bool


@dataclass(frozen=True)
class Comparison:
    """The result of `dr-analyze compare`.

    Attributes:
        runs: The trainings, in the order in which they were named.
        pairs: How each but the first differs from the first.
        at_equal: Mean progress of each at the least steps, wall time and money of all of them.
        problems: What was wrong with files or is not comparable, a sentence each.
        html: The page that was written.
    """

    runs: list[ComparedRun]
    pairs: list[ComparedPair]
    at_equal: dict[str, dict[str, Any]]
    problems: list[str] = field(default_factory=list)
    html: str | None = None


def compare_runs(runs: Sequence[Run]) -> Comparison:
    """Compare two or more trainings; those of one name are called by where they were read."""
    names = [run.name for run in runs]
    runs = [replace(run, name=run.origin) if names.count(run.name) > 1 else run for run in runs]
    compared = [_compared(run) for run in runs]
    problems = [f"{run.name}: {text}" for run in runs for text in run.problems]
    worlds = {run.world for run in runs}
    if len(worlds) > 1:
        named = ", ".join(sorted(world or "an unknown track" for world in worlds))
        problems.append(
            f"The trainings were driven on different tracks ({named}): lap times and progress do "
            "not mean the same."
        )
    return Comparison(
        compared,
        [_pair(runs[0], run) for run in runs[1:]],
        {
            name: found
            for name in ("steps", "wall_s", "usd")
            if (found := _at_equal(compared, name))
        },
        problems,
    )


def _compared(run: Run) -> ComparedRun:
    table = run.iterations
    late = _late(run)
    episodes = run.episodes[run.episodes["iteration"].isin(late)]
    rows = table[table.index.isin(late)]
    laps = table["best_lap_s"].dropna()
    curve = _curve(run)
    first = next((i for i, laps in enumerate(table["complete_laps"]) if laps), None)
    of_laps = rows["mean_lap_s"].dropna()
    weights = rows.loc[of_laps.index, "complete_laps"]
    count = float(rows["episodes"].sum())
    newest = run.evaluations[-1] if run.evaluations else None
    return ComparedRun(
        model=run.name,
        origin=run.origin,
        world=run.world,
        iterations=len(table),
        episodes=int(table["episodes"].sum()),
        steps=int(np.nansum(table["steps"].to_numpy(float))),
        wall_s=_last(curve["wall_s"]),
        machine_hours=run.machine_hours,
        cost_usd=run.cost_usd,
        complete_laps=int(table["complete_laps"].sum()),
        best_lap_s=float(laps.min()) if len(laps) else None,
        late_iterations=len(late),
        late_reward=plain(
            episodes["reward"].mean() if len(episodes) else rows["mean_reward"].mean()
        ),
        late_progress=plain(
            episodes["progress"].mean() if len(episodes) else rows["mean_progress"].mean()
        ),
        late_lap_share=100.0 * float(rows["complete_laps"].sum()) / count if count else None,
        late_lap_s=float(np.average(of_laps, weights=weights)) if len(of_laps) else None,
        first_lap_steps=None if first is None else _whole(curve["steps"][first]),
        goals=[_goal(curve, goal) for goal in GOALS],
        curve=curve,
        evaluated_laps=None if newest is None else newest.laps.driven,
        evaluated_clean=None if newest is None else newest.laps.clean,
        evaluated_resets=None if newest is None else newest.resets,
        evaluated_median_s=None if newest is None else newest.laps.median_s,
    )


def _late(run: Run) -> list[int]:
    count = len(run.iterations)
    kept = min(LATE_MOST, max(LATE_LEAST, round(LATE_SHARE * count)))
    return [int(n) for n in run.iterations.index[-kept:]]


def _curve(run: Run) -> dict[str, list[float | None]]:
    table = run.iterations
    steps = np.cumsum(np.nan_to_num(table["steps"].to_numpy(float)))
    wall = np.cumsum(table["wall_s"].to_numpy(float))
    usd = np.full(len(table), np.nan)
    if run.cost_usd is not None and len(wall) and wall[-1] > 0:
        usd = run.cost_usd * wall / wall[-1]
    columns = {
        "steps": steps,
        "wall_s": wall,
        "usd": usd,
        "reward": table["mean_reward"].to_numpy(float),
        "progress": table["mean_progress"].to_numpy(float),
        "lap_s": table["mean_lap_s"].to_numpy(float),
        "eval_progress": table["eval_mean_progress"].to_numpy(float),
    }
    return {name: plain(values) for name, values in columns.items()}


def _smooth(curve: dict[str, list[float | None]]) -> list[float]:
    values = [np.nan if value is None else value for value in curve["progress"]]
    return [float(np.mean(values[max(0, end - SMOOTH) : end])) for end in range(1, len(values) + 1)]


def _goal(curve: dict[str, list[float | None]], goal: float) -> dict[str, Any]:
    reached = next((i for i, value in enumerate(_smooth(curve)) if value >= goal), None)
    found: dict[str, Any] = {"progress": goal, "iteration": reached}
    for name in ("steps", "wall_s", "usd"):
        found[name] = None if reached is None else curve[name][reached]
    return found


def _at_equal(runs: Sequence[ComparedRun], name: str) -> dict[str, Any] | None:
    """The progress of each training when it had used what the shortest used in all."""
    totals = [_last(run.curve[name]) for run in runs]
    if any(total is None or total <= 0 for total in totals):
        return None
    limit = min(total for total in totals if total is not None)
    progress = []
    for run in runs:
        used = [np.inf if value is None else value for value in run.curve[name]]
        at = sum(value <= limit * (1.0 + 1e-9) for value in used)
        progress.append(_smooth(run.curve)[max(0, at - 1)])
    return {"limit": limit, "progress": plain(progress)}


def _pair(first: Run, second: Run) -> ComparedPair:
    sides = [run.episodes[run.episodes["iteration"].isin(_late(run))] for run in (first, second)]
    files = _file_differences(first, second)
    known = all(run.files.get("reward_function.py") for run in (first, second))
    same_reward = known and "reward_function.py" not in files
    progress = compare_means(*(_groups(side, "progress") for side in sides))
    share = compare_means(*(_groups(side, "complete", 100.0) for side in sides))
    laps = compare_means(*(_groups(side[side["complete"].astype(bool)], "time") for side in sides))
    reward = None
    if same_reward:
        reward = compare_means(*(_groups(side, "reward") for side in sides))
    sentence = _sentence(first.name, second.name, progress, share, laps)
    return ComparedPair(
        second.name,
        _plain(progress),
        _plain(share),
        _plain(laps),
        _plain(reward),
        sentence,
        files,
        same_reward,
    )


def _groups(episodes: Any, column: str, factor: float = 1.0) -> list[Numbers]:
    return [factor * group.to_numpy(float) for _, group in episodes.groupby("iteration")[column]]


def _plain(difference: Difference | None) -> dict[str, Any] | None:
    if difference is None:
        return None
    return {**plain(difference), "beyond_chance": difference.beyond_chance}


def _sentence(
    first: str,
    second: str,
    progress: Difference | None,
    share: Difference | None,
    laps: Difference | None,
) -> str:
    if progress is None:
        return "There are too few iterations with traces to tell a difference from chance."
    told = []
    if progress.beyond_chance:
        word = "further" if progress.difference > 0 else "less far"
        told.append(f"drives {word} ({progress.difference:+.1f} % of a lap)")
    if share is not None and share.beyond_chance:
        word = "more" if share.difference > 0 else "fewer"
        told.append(f"drives {word} clean laps ({share.difference:+.0f} of 100)")
    if laps is not None and laps.beyond_chance:
        word = "slower" if laps.difference > 0 else "faster"
        told.append(f"laps {word} ({laps.difference:+.2f} s)")
    if not told:
        return f"The differences between {first} and {second} are within chance."
    listed = " and ".join(filter(None, (", ".join(told[:-1]), told[-1])))
    return f"{second} {listed} than {first}; this is more than chance."


def _file_differences(first: Run, second: Run) -> dict[str, str]:
    found = {}
    for name in sorted({*first.files, *second.files}):
        before, after = (_lines(run.files.get(name, "")) for run in (first, second))
        if before and after and before != after:
            lines = list(
                difflib.unified_diff(
                    before, after, f"{first.name}/{name}", f"{second.name}/{name}", lineterm="", n=1
                )
            )
            cut = lines[:_DIFF_LINES] + (["..."] if len(lines) > _DIFF_LINES else [])
            found[name] = "\n".join(cut)
    return found


def _lines(text: str) -> list[str]:
    try:
        return json.dumps(json.loads(text), indent=2, sort_keys=True).splitlines()
    except (ValueError, RecursionError):
        return text.splitlines()


def _last(values: list[float | None]) -> float | None:
    return values[-1] if values else None


def _whole(value: float | None) -> int | None:
    return None if value is None else int(value)
