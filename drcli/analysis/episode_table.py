"""Numbers the episodes of all workers, and makes a row for each."""

import numpy as np

from drcli.analysis.run import Numbers, deepracer_logs, spans
from drcli.base.installation import lazy_imports
from drcli.records.trace import STEP_S

with lazy_imports():
    import pandas as pd

EPISODE_COLUMNS = (
    *("iteration", "worker", "episode", "steps", "start_at", "progress", "time", "dist"),
    *("reward", "speed", "complete", "status", "quintile"),
)


def number_episodes(steps: "pd.DataFrame") -> "tuple[pd.DataFrame, list[str]]":
    """Sort steps by iteration, worker, episode and step, and number the episodes from 0.

    The numbers are those of deepracer-utils (`DeepRacerLog.load_training_trace`) if its rule, which
    takes the number of episodes from iteration 0, gives each its own; else without a gap.

    Returns:
        The steps with the column `unique_episode`, and sentences on what was wrong.
    """
    names = ("steps", "episode", "worker", "iteration")
    order = np.lexsort([steps[name].to_numpy() for name in names])
    if (np.diff(order) < 0).any():
        steps = steps.take(order).reset_index(drop=True)
    problems = []
    columns = [steps[name].to_numpy() for name in ("iteration", "worker", "episode")]
    new = np.zeros(len(steps), bool)
    new[0] = True
    for column in columns:
        new[1:] |= column[1:] != column[:-1]
    twice = ~new & np.concatenate([[False], np.diff(steps["steps"].to_numpy()) == 0])
    if twice.any():
        problems.append(
            f"{int(twice.sum()):,} steps are there twice, the first in iteration "
            f"{int(columns[0][twice.argmax()])}; each is counted once."
        )
        keep = ~twice
        steps = steps[keep].reset_index(drop=True)
        columns = [column[keep] for column in columns]
        new = new[keep]
    numbers = np.cumsum(new) - 1
    first = np.flatnonzero(new)
    usual = _as_the_library(*(column[first].astype(np.int64) for column in columns))
    if usual is None:
        problems.append(
            "The numbers of the episodes do not fit those of iteration 0, so the episodes are "
            "numbered anew, in their order."
        )
    else:
        numbers = usual[numbers]
    steps["unique_episode"] = pd.Series(numbers, dtype="int32")
    return steps, problems


def _as_the_library(
    iteration: Numbers,
    worker: Numbers,
    episode: Numbers,
) -> Numbers | None:
    most = int(worker.max()) + 1
    share = np.zeros(most, np.int64)
    of_first = iteration == 0
    np.maximum.at(share, worker[of_first], episode[of_first] + 1)
    if not share.all():
        return None
    before = np.concatenate([[0], np.cumsum(share)[:-1]])
    numbers = episode % share[worker] + before[worker] + iteration * share.sum()
    if not (np.diff(numbers) > 0).all() or numbers[-1] >= 2**31:
        return None
    return np.asarray(numbers)


def episode_table(steps: "pd.DataFrame") -> "pd.DataFrame":
    """A row for each episode; index unique_episode.

    Most numbers are those of deepracer-utils (`AnalysisUtils.simulation_agg`): progress is the
    greatest of all steps, and the distance is summed from the first row on.
    """
    found = aggregated(steps, "unique_episode")
    _, last = spans(steps["unique_episode"].to_numpy())
    ends = steps.iloc[last]
    table = pd.DataFrame(
        {
            "iteration": found["iteration"],
            "worker": ends["worker"].to_numpy(),
            "episode": ends["episode"].to_numpy(),
            "steps": found["steps"].astype(int),
            "start_at": found["start_at"],
            "progress": found["progress"],
            "time": found["time"],
            "dist": found["dist"],
            "reward": found["reward"],
            "speed": found["speed"],
            "complete": found["complete"].astype(bool),
            "status": ends["episode_status"].astype(str).to_numpy(),
            "quintile": found["quintile"],
        }
    )
    table.index = pd.Index(found["unique_episode"], name="unique_episode")
    return table


def aggregated(steps: "pd.DataFrame", group: str, *, is_eval: bool = False) -> "pd.DataFrame":
    """The aggregates of deepracer-utils, a row for each (iteration, `group`).

    But the time is that of the metrics: it counts the step of the `prepare` row, which the library
    leaves out.
    """
    analysis = deepracer_logs().AnalysisUtils
    names = ["iteration", group, "steps", "x", "y", "speed", "reward", "progress"]
    frame = steps[[*names, "closest_waypoint", "tstamp"]].copy()
    status = steps["episode_status"]
    if not is_eval:
        frame["new_reward"] = 0.0  # the library prints a line if it has to add this itself
        first, _ = spans(steps[group].to_numpy())
        if "prepare" not in status.cat.categories:
            status = status.cat.add_categories("prepare")
        status = status.copy()
        # An episode whose first row was damaged would begin at the end of the one before.
        status.iloc[first] = "prepare"
    frame["episode_status"] = status
    found = analysis.simulation_agg(frame, secondgroup=group, is_eval=is_eval)
    keys = ["iteration", group]
    prepared = pd.MultiIndex.from_frame(steps.loc[(status == "prepare").to_numpy(), keys])
    found["time"] += STEP_S * pd.MultiIndex.from_frame(found[keys]).isin(prepared)
    return found
