"""Complete laps: number, times, records."""

from dataclasses import dataclass

import numpy as np

from drcli.analysis.run import Run

PERCENTILES = (1, 10, 25, 50, 75)
"""As in the tables of deepracer-on-the-spot."""


@dataclass(frozen=True)
class BestLap:
    iteration: int
    unique_episode: int
    seconds: float


@dataclass(frozen=True)
class LapTimes:
    """The complete laps; `median_s` is of the last third."""

    laps: int
    first_iteration: int | None
    best_s: float | None
    median_s: float | None
    percentiles: dict[int, float]
    best_laps: tuple[BestLap, ...]


def lap_times(run: Run) -> LapTimes:
    table = run.episodes
    if not len(table):
        return LapTimes(0, None, None, None, {}, ())
    done = table[table["complete"].astype(bool) & (table["time"] > 0)]
    if not len(done):
        return LapTimes(0, None, None, None, {}, ())
    time_s = np.asarray(done["time"], dtype=np.float64)
    iteration = np.asarray(done["iteration"], dtype=np.int64)
    names = np.asarray(done.index, dtype=np.int64)
    best: list[BestLap] = []
    for n in np.argsort(iteration, kind="stable"):
        if not best or time_s[n] < best[-1].seconds:
            best.append(BestLap(int(iteration[n]), int(names[n]), float(time_s[n])))
    first, last = int(table["iteration"].min()), int(table["iteration"].max())
    late = time_s[iteration > last - (last - first + 1) / 3]
    return LapTimes(
        laps=len(done),
        first_iteration=int(iteration.min()),
        best_s=float(time_s.min()),
        median_s=float(np.median(late)) if len(late) else None,
        percentiles={p: float(np.percentile(time_s, p)) for p in PERCENTILES},
        best_laps=tuple(best),
    )
