"""A row for each iteration: from its episodes, else from metrics."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from drcli.exchange.iteration import IterationRecord

if TYPE_CHECKING:
    import pandas as pd

ITERATION_COLUMNS = (
    *("episodes", "steps", "mean_reward", "median_reward", "std_reward", "best_reward"),
    *("mean_progress", "complete_laps", "best_lap_s", "mean_lap_s"),
    *("eval_mean_reward", "eval_mean_progress", "eval_laps", "eval_best_lap_s", "wall_s", "traced"),
    "phase",
)

_LONG_PAUSE = 20.0
"""Times the usual time: a pause, such as a night."""


def iteration_table(
    steps: "pd.DataFrame",
    episodes: "pd.DataFrame",
    records: "pd.DataFrame",
    curve: Sequence[IterationRecord],
) -> "pd.DataFrame":
    """The table `Run.iterations`; `curve` is empty for models of others."""
    import pandas as pd

    table = _of_episodes(episodes)
    table["traced"] = True
    missing = _untraced(records[records["phase"] == "training"], table)
    if len(missing):
        table = pd.concat([table, _of_episodes(missing.assign(steps=np.nan))])
    untold = [record for record in curve if record.iteration not in table.index]
    if untold:
        table = pd.concat([table, _of_curve(untold)])
    table = table.sort_index()
    table.index = table.index.astype(int)
    table.index.name = "iteration"
    table["traced"] = table["traced"].eq(True)
    _add_evaluations(table, records[records["phase"] == "evaluation"], curve)
    table["wall_s"] = _wall_s(table, steps, curve)
    table["phase"] = _phases(table.index, curve)
    return table.reindex(columns=list(ITERATION_COLUMNS))


def _untraced(training: "pd.DataFrame", table: "pd.DataFrame") -> "pd.DataFrame":
    """Only of whole iterations: metrics may be ahead of the traces."""
    missing = training[~training["iteration"].isin(table.index)]
    if not len(missing) or not len(table):
        return missing
    last = missing["iteration"].max()
    unfinished = (
        last > table.index.max() and (missing["iteration"] == last).sum() < table["episodes"].max()
    )
    return missing[missing["iteration"] != last] if unfinished else missing


def _of_episodes(episodes: "pd.DataFrame") -> "pd.DataFrame":
    import pandas as pd

    groups = episodes.groupby("iteration")
    reward = groups["reward"]
    laps = episodes[episodes["complete"].astype(bool)].groupby("iteration")["time"]
    return pd.DataFrame(
        {
            "episodes": groups.size(),
            "steps": groups["steps"].sum(min_count=1),
            "mean_reward": reward.mean(),
            "median_reward": reward.median(),
            "std_reward": reward.std(ddof=0),
            "best_reward": reward.max(),
            "mean_progress": groups["progress"].mean(),
            "complete_laps": groups["complete"].sum().astype(int),
            "best_lap_s": laps.min(),
            "mean_lap_s": laps.mean(),
        }
    )


def _of_curve(curve: Sequence[IterationRecord]) -> "pd.DataFrame":
    import pandas as pd

    rows = {
        record.iteration: {
            "episodes": record.episodes,
            "steps": record.steps,
            "mean_reward": record.mean_reward,
            "mean_progress": record.mean_progress,
            "complete_laps": record.full_laps,
            "best_lap_s": np.nan if record.best_lap_s is None else record.best_lap_s,
        }
        for record in curve
    }
    return pd.DataFrame.from_dict(rows, orient="index")


def _add_evaluations(
    table: "pd.DataFrame", records: "pd.DataFrame", curve: Sequence[IterationRecord]
) -> None:
    names = ("eval_mean_reward", "eval_mean_progress", "eval_laps", "eval_best_lap_s")
    for name in names:
        table[name] = np.nan
    if len(records):
        groups = records.groupby("iteration")
        table["eval_mean_reward"] = groups["reward"].mean()
        table["eval_mean_progress"] = groups["progress"].mean()
        table["eval_laps"] = groups["complete"].sum().astype(float)
        laps = records[records["complete"]].groupby("iteration")["time"]
        table["eval_best_lap_s"] = laps.min()
    for record in curve:
        if record.evaluation_progress and record.iteration in table.index:
            row = record.iteration
            # Exact, where the metrics have whole percents.
            table.loc[row, "eval_mean_progress"] = float(np.mean(record.evaluation_progress))
            table.loc[row, "eval_laps"] = float(len(record.evaluation_lap_s))
            if record.evaluation_lap_s:
                table.loc[row, "eval_best_lap_s"] = min(record.evaluation_lap_s)


def _phases(numbers: "pd.Index[int]", curve: Sequence[IterationRecord]) -> list[str]:
    known = {record.iteration: record.phase for record in curve}
    newest = max(known, default=-1)
    return [known.get(min(int(number), newest), "") for number in numbers]


def _wall_s(
    table: "pd.DataFrame", steps: "pd.DataFrame", curve: Sequence[IterationRecord]
) -> "pd.Series":
    import pandas as pd

    if curve:
        elapsed = pd.Series({record.iteration: record.elapsed_s for record in curve}).sort_index()
        return elapsed.diff().fillna(elapsed.iloc[0]).clip(lower=0.0).reindex(table.index)
    clock = steps["wall_clock"]
    if not len(steps) or clock.isna().all():
        return pd.Series(np.nan, index=table.index)
    groups = clock.groupby(steps["iteration"])
    ends = groups.max()
    lasted = ends.diff()
    lasted.iloc[0] = ends.iloc[0] - groups.min().iloc[0]
    gaps = ends.index.to_series().diff().fillna(1)
    lasted = lasted.where(gaps == 1)  # the trace before is missing
    usual = lasted.median()
    return lasted.where((lasted >= 0) & (lasted <= _LONG_PAUSE * usual), usual).reindex(table.index)
