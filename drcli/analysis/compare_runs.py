"""Compares trainings: curves, cost, files and statistical differences."""

import difflib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Annotated, Any

import numpy as np

from drcli.analysis.run import Numbers, Run
from drcli.base.json_record import keys_of, plain
from drcli.base.report import Cell, Col, Rows, Styled, View, bold, columns, dim
from drcli.model.history import SMOOTH

# Uncertainty of a difference of two trainings, by bootstrap.


RESAMPLES = 2000

SURE = 0.95
LEAST_GROUPS = 3


@dataclass(frozen=True)
class Difference:
    """Second training less first, with the interval that chance leaves plausible."""

    difference: float
    low: float
    high: float

    @property
    def beyond_chance(self) -> bool:
        return self.low > 0.0 or self.high < 0.0


def compare_means(
    first: Sequence[Numbers], second: Sequence[Numbers], *, seed: int = 0
) -> Difference | None:
    """The difference of a mean over episodes; None where a side has too few iterations with values.

    Each array has the episodes of an iteration. They were driven by the same weights and are
    alike, so iterations are drawn first, then episodes within each.
    """
    sides = [[group for group in side if len(group)] for side in (first, second)]
    if min(map(len, sides)) < LEAST_GROUPS:
        return None
    random = np.random.default_rng(seed)
    found = [float(np.concatenate(side).mean()) for side in sides]
    before, after = (_drawn_means(random, side) for side in sides)
    low, high = np.percentile(after - before, [50.0 * (1.0 - SURE), 50.0 * (1.0 + SURE)])
    return Difference(found[1] - found[0], float(low), float(high))


def _drawn_means(random: np.random.Generator, groups: Sequence[Numbers]) -> Numbers:
    sizes = np.array([len(group) for group in groups])
    table = np.zeros((len(groups), sizes.max()))
    for row, group in zip(table, groups, strict=True):
        row[: len(group)] = group
    chosen = random.integers(len(groups), size=(RESAMPLES, len(groups)))
    sums = np.zeros(RESAMPLES)
    for at in range(len(groups)):
        group = chosen[:, at]
        places = random.integers(sizes[group][:, None], size=(RESAMPLES, int(sizes.max())))
        counted = np.arange(sizes.max()) < sizes[group][:, None]
        sums += (table[group[:, None], places] * counted).sum(axis=1)
    return np.asarray(sums / sizes[chosen].sum(axis=1))


LATE_SHARE, LATE_LEAST, LATE_MOST = 0.2, 5, 30
GOALS = (25.0, 50.0, 75.0)
"""Percent of mean progress."""

_DIFF_LINES = 400


def _duration(seconds: float) -> str:
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:.2f} h"


@dataclass(frozen=True)
class ComparedRun:
    """One of the trainings."""

    model: Annotated[str, "Its name."]
    origin: Annotated[str, "Where it was read."]
    world: Annotated[str | None, "Its track; None if unknown."]
    iterations: Annotated[int, "Their number.", Col("iterations", "{:,.0f}")]
    episodes: Annotated[int, "Training episodes."]
    steps: Annotated[int, "Steps of all iterations.", Col("steps", "{:,.0f}")]
    wall_s: Annotated[
        float | None, "Wall time of all iterations; None if unknown.", Col("wall time", _duration)
    ]
    machine_hours: Annotated[float | None, "Of all starts; None if unknown."]
    cost_usd: Annotated[float | None, "What they cost; None if unknown.", Col("cost", "{:.2f} USD")]
    complete_laps: Annotated[
        int,
        "Training episodes that were complete laps; all of them are clean.",
        Col("clean laps", "{:,.0f}"),
    ]
    best_lap_s: Annotated[
        float | None, "The fastest; None without one.", Col("best lap", "{:.3f} s")
    ]
    late_iterations: Annotated[int, "How many of the newest iterations the next four are of."]
    late_reward: Annotated[
        float | None, "Mean reward of an episode.", Col("late reward", "{:,.1f}")
    ]
    late_progress: Annotated[
        float | None, "Mean progress, percent.", Col("late progress", "{:.1f} %")
    ]
    late_lap_share: Annotated[
        float | None, "Share of complete laps, percent.", Col("late clean laps", "{:.1f} %")
    ]
    late_lap_s: Annotated[
        float | None, "Mean lap time; None without a lap.", Col("late lap time", "{:.3f} s")
    ]
    first_lap_steps: Annotated[
        int | None, "Steps until the iteration with the first complete lap; None without one."
    ]
    goals: Annotated[
        list[dict[str, Any]], "For each of GOALS, steps, wall time and money until it was reached."
    ]
    curve: Annotated[
        dict[str, list[float | None]],
        "For each iteration: steps, wall_s and usd until its end, reward, progress, "
        "mean lap time (lap_s) and mean progress of its evaluation (eval_progress).",
    ]
    evaluated_laps: Annotated[
        int | None,
        "Laps of the newest evaluation on its own; None without one.",
        Col("evaluation laps", "{:,.0f}", none=""),
    ] = None
    evaluated_clean: Annotated[
        int | None,
        "How many of them are clean: without a reset and without a penalty.",
        Col("of them clean", "{:,.0f}", none=""),
    ] = None
    evaluated_resets: Annotated[
        int | None, "How often the car was put back in them.", Col("resets", "{:,.0f}", none="")
    ] = None
    evaluated_median_s: Annotated[
        float | None,
        "Median time of the clean ones; None without one.",
        Col("median clean lap", "{:.3f} s", none=""),
    ] = None


@dataclass(frozen=True)
class ComparedPair:
    """How a training differs from the first one."""

    model: Annotated[str, "Its name."]
    progress: Annotated[
        dict[str, Any] | None,
        "Difference of the mean progress of the newest iterations, percent of a lap.",
    ]
    lap_share: Annotated[dict[str, Any] | None, "Of the share of complete laps, percent."]
    lap_s: Annotated[dict[str, Any] | None, "Of the mean lap time, seconds."]
    reward: Annotated[
        dict[str, Any] | None,
        "Of the mean reward; None if the reward functions differ or are not known.",
    ]
    sentence: Annotated[str, "What is larger than chance, in words."]
    files: Annotated[
        dict[str, str],
        "The difference of each file, in the form of `diff -u`; empty where they are equal.",
    ]
    same_reward: Annotated[bool, "Whether both reward functions are known and equal."]

    def intervals(self) -> dict[str, dict[str, Any]]:
        """Differences by what differs, with its unit."""
        known = {
            "progress (%)": self.progress,
            "clean laps (of 100)": self.lap_share,
            "lap time (s)": self.lap_s,
            "reward": self.reward,
        }
        return {name: found for name, found in known.items() if found is not None}

    def parts(self, first: str) -> View:
        """Beside the training `first`."""
        styles = {"+": "green", "-": "red", "@": "cyan"}
        yield bold(self.sentence)
        yield [
            f"{name} {found['difference']:+.2f} (95 % between {found['low']:+.2f} and "
            f"{found['high']:+.2f})"
            for name, found in self.intervals().items()
        ]
        for name, text in self.files.items():
            yield dim(f"{name}: {first} (-), {self.model} (+)")
            yield [Styled(line, styles.get(line[:1], "")) for line in text.splitlines()[2:]]
        yield not self.files and dim("Their files are equal, or not known.")


@dataclass(frozen=True)
class Comparison:
    """The result of `dr-analyze compare`."""

    runs: Annotated[list[ComparedRun], "The trainings, in the order in which they were named."]
    pairs: Annotated[list[ComparedPair], "How each but the first differs from the first."]
    at_equal: Annotated[
        dict[str, dict[str, Any]],
        "Mean progress of each at the least steps, wall time and money of all of them.",
    ]
    problems: Annotated[
        list[str], "What was wrong with files or is not comparable, a sentence each."
    ] = field(default_factory=list)
    html: Annotated[str | None, "The page that was written."] = None

    def numbers(self) -> list[list[Cell]]:
        """Rows of a name and a cell for each training."""
        rows = [
            [col.name, *(col.cell(run, name) for run in self.runs)]
            for name, col in columns(ComparedRun).items()
        ]
        for place, goal in enumerate(self.runs[0].goals):
            steps = [run.goals[place]["steps"] for run in self.runs]
            known = ["never" if number is None else f"{number:,.0f} steps" for number in steps]
            if any(number is not None for number in steps):
                rows.append([f"{goal['progress']:.0f} % after", *known])
        forms = {"steps": "{:,.0f} steps".format, "wall_s": _duration, "usd": "{:.2f} USD".format}
        for used, equal in ((used, self.at_equal.get(used)) for used in forms):
            if equal is not None:
                shares = ("-" if share is None else f"{share:.1f} %" for share in equal["progress"])
                rows.append([f"at {forms[used](equal['limit'])}", *shares])
        return [row for row in rows if any(row[1:])]

    def view(self) -> View:
        late = ", ".join(str(run.late_iterations) for run in self.runs)
        names = ["", *(run.model for run in self.runs)]
        pairs = (pair.parts(self.runs[0].model) for pair in self.pairs)
        return [
            Rows(names, self.numbers(), left=("",)),
            dim(f"late: the newest {late} iterations."),
            *chain.from_iterable(pairs),
            self.html and f"Wrote {self.html}",
        ]


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
        first_lap_steps=None if first is None else int(curve["steps"][first] or 0),
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
    return {name: plain(values.tolist()) for name, values in columns.items()}


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
    return None if difference is None else keys_of(difference)


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
    for found, more, less, form in (
        (progress, "drives further", "drives less far", "{:+.1f} % of a lap"),
        (share, "drives more clean laps", "drives fewer clean laps", "{:+.0f} of 100"),
        (laps, "laps slower", "laps faster", "{:+.2f} s"),
    ):
        if found is not None and found.beyond_chance:
            told.append(
                f"{more if found.difference > 0 else less} ({form.format(found.difference)})"
            )
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
