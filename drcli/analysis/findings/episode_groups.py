"""Episodes by start, and by fifths of the training."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drcli.analysis.run import Run

if TYPE_CHECKING:
    import pandas as pd

START_GROUPS = 10


@dataclass(frozen=True)
class EpisodeGroup:
    """Named by quintile, such as 1st, or waypoints, such as 0-11."""

    name: str
    episodes: int
    mean_progress: float
    complete_share: float
    mean_reward: float
    best_lap_s: float | None


def by_quintile(run: Run) -> tuple[EpisodeGroup, ...]:
    table = run.episodes
    if not len(table) or "quintile" not in table:
        return ()
    names = sorted(set(table["quintile"].dropna().astype(str)))
    quintile = table["quintile"].astype(str)
    return tuple(_group(name, table[quintile == name]) for name in names)


def by_start(run: Run) -> tuple[EpisodeGroup, ...]:
    """The episodes of the last third, by where they start."""
    table = run.episodes
    if not len(table) or "start_at" not in table:
        return ()
    first, last = int(table["iteration"].min()), int(table["iteration"].max())
    late = table[table["iteration"] > last - (last - first + 1) / 3]
    start = np.maximum(np.asarray(late["start_at"].fillna(0), dtype=np.int64), 0)
    places = max(_last_waypoint(run.steps), int(start.max())) + 1
    size = min(START_GROUPS, places)
    group = start * size // places
    return tuple(
        _group(f"{-(-n * places // size)}-{-(-(n + 1) * places // size) - 1}", late[group == n])
        for n in np.unique(group).tolist()
    )


def _last_waypoint(steps: "pd.DataFrame") -> int:
    if "closest_waypoint" not in steps:
        return 0
    highest = steps["closest_waypoint"].max()
    return int(highest) if np.isfinite(highest) else 0


def _group(name: str, rows: "pd.DataFrame") -> EpisodeGroup:
    done = rows["complete"].astype(bool)
    times = rows["time"][done]
    return EpisodeGroup(
        name=name,
        episodes=len(rows),
        mean_progress=float(rows["progress"].mean()),
        complete_share=float(done.mean()),
        mean_reward=float(rows["reward"].mean()),
        best_lap_s=float(times.min()) if len(times) else None,
    )
