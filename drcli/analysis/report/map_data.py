"""What the map of a report draws."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drcli.analysis.report.lap_choice import LapChoice
from drcli.analysis.report.map_laps import FINISHED, lap_data, located, same_road, with_motion
from drcli.analysis.report.packing import numbers, quantised
from drcli.analysis.run import Run
from drcli.exchange.trace import VIOLATIONS
from drsim.track.track import Track

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_CELLS_M = (0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 20.0, 100.0)
_MOST_CELLS = 3000
_ROAD_POINTS = 400
_MOST_ENDS = 10_000
_SHOWN_SLIP_DEG = 20.0
"""Cars of this size slide by a few degrees."""

_MARGIN_M = 0.5
FIFTHS = ("first", "second", "third", "fourth", "last")


def map_data(run: Run, laps: LapChoice) -> dict[str, Any] | None:
    steps = located(run.steps)
    if steps.empty:
        return None
    steps = with_motion(steps)
    trials = [located(evaluation.steps) for evaluation in same_road(run)]
    bounds = bounds_of(steps, run.track)
    driven = steps[steps["episode_status"] != "prepare"]
    limits = _limits(driven)
    ends = {*map(str, run.episodes["status"].unique()), "in_progress", *VIOLATIONS}
    statuses = sorted({*ends, "lap_complete", FINISHED})
    data = {
        "bounds": bounds,
        "closed": run.track is None or run.track.closed,
        "road": None if run.track is None else _road(run.track),
        "limits": limits,
        "units": {
            "reward": ["", "", ""],
            "driven": [" m/s", "", ""],
            "speed": [" m/s", "", ""],
            "steering": ["°", " (right)", " (left)"],
            "slip": ["°", " (to its right)", " (to its left)"],
            "visits": ["", "", " steps"],
        },
        "statuses": statuses,
        "cells": _cells(driven, run.episodes, limits),
        "ends": _ends(steps, run.episodes, laps.ids, bounds, statuses),
    }
    return data | lap_data(steps, run, laps, trials, bounds, statuses, limits)


def bounds_of(steps: "pd.DataFrame", track: Track | None) -> list[float]:
    """Least x, least y, greatest x, greatest y, with a margin."""
    if track is not None:
        low_x, low_y, high_x, high_y = track.bounds
    else:
        (low_x, high_x), (low_y, high_y) = (
            np.percentile(steps[name], [0.1, 99.9]).tolist() for name in ("x", "y")
        )
    return [low_x - _MARGIN_M, low_y - _MARGIN_M, high_x + _MARGIN_M, high_y + _MARGIN_M]


def _limits(driven: "pd.DataFrame") -> dict[str, list[float]]:
    """Of colour scales; a few extremes do not flatten the rest."""

    def middle(name: str, low: float, high: float) -> list[float]:
        values = driven[name].to_numpy(np.float64)
        values = values[np.isfinite(values)]
        found: list[float] = np.percentile(values, [low, high]).tolist() if len(values) else [0, 1]
        return found

    angle = driven["steering_angle"].abs().max()
    most_deg = float(angle) if math.isfinite(angle) and angle > 0 else 30.0
    return {
        "reward": middle("reward", 2.0, 98.0),
        "driven": middle("driven", 2.0, 99.0),
        "speed": middle("speed", 1.0, 99.0),
        "steering": [-most_deg, most_deg],
        "slip": [-_SHOWN_SLIP_DEG, _SHOWN_SLIP_DEG],
        "visits": [1.0, 2.0],
    }


def _road(track: Track) -> dict[str, object]:
    every = max(math.ceil(len(track.center) / _ROAD_POINTS), 1)
    rows = np.arange(0, len(track.center) - int(track.closed), every)
    inner, center, outer = (
        (line if len(line) == len(track.center) else _resampled(line, len(track.center)))[rows]
        for line in (track.inner, track.center, track.outer)
    )
    low_x, low_y, high_x, high_y = track.bounds
    lines = {"inner": inner, "center": center, "outer": outer}
    data: dict[str, object] = {}
    for name, line in lines.items():
        data[f"{name}_x"] = quantised(line[:, 0], "i16", low=low_x, high=high_x)
        data[f"{name}_y"] = quantised(line[:, 1], "i16", low=low_y, high=high_y)
    numbered = next(n for n in (5, 10, 20, 50, 100, 1000) if len(track.center) / n <= 24 or n > 100)
    return data | {"index": numbers(rows), "every": [max(numbered // every, 1)]}


def _resampled(line: Floats, count: int) -> Floats:
    at = np.linspace(0, len(line) - 1, count)
    return np.stack([np.interp(at, np.arange(len(line)), column) for column in line.T], axis=1)


def ground_cells(xy: Floats, size_m: float) -> tuple[Integers, Integers]:
    """The squares of the ground in which positions, shape (n, 2), metres within 1e5, lie.

    Returns:
        Sorted columns and rows from the origin, shape (cells, 2), and the index of each position's,
        shape (n,).
    """
    places = np.floor(xy / size_m).astype(np.int64)
    first = places.min(axis=0, initial=0)
    rows = int(places[:, 1].max(initial=0) - first[1]) + 1
    # One number for both: rows of two take NumPy many times longer to sort.
    column, row = (places - first).T
    numbers_, cell = np.unique(column * rows + row, return_inverse=True)
    return np.stack(np.divmod(numbers_, rows), axis=1) + first, cell.reshape(-1)


def _cells(
    driven: "pd.DataFrame", episodes: "pd.DataFrame", limits: dict[str, list[float]]
) -> dict[str, object]:
    xy = driven[["x", "y"]].to_numpy(np.float64)
    for size_m in _CELLS_M:
        cells, cell = ground_cells(xy, size_m)
        if len(cells) <= _MOST_CELLS:
            break
    fifth = fifth_of(episodes).reindex(driven["unique_episode"]).to_numpy()
    periods = []
    for number in range(6):
        chosen = np.ones(len(cell), bool) if number == 0 else fifth == number
        count = np.bincount(cell[chosen], minlength=len(cells)).astype(np.float64)
        if number == 0 and len(count):
            # A few places where every episode starts would flatten the rest.
            limits["visits"] = [1.0, max(float(np.percentile(count, 97)), 2.0)]
        data = {"visits": numbers(np.where(count > 0, count, np.nan))}
        for name, column in _COLUMNS.items():
            values = driven[column].to_numpy(np.float64)
            known = chosen & np.isfinite(values)
            sums = np.bincount(cell[known], weights=values[known], minlength=len(cells))
            those = np.bincount(cell[known], minlength=len(cells))
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = np.where(those > 0, sums / those, np.nan)
            data[name] = quantised(mean, "i8", low=limits[name][0], high=limits[name][1])
        periods.append(data)
    return {
        "size": size_m,
        "x": numbers((cells[:, 0] + 0.5) * size_m),
        "y": numbers((cells[:, 1] + 0.5) * size_m),
        "periods": periods,
    }


_COLUMNS = {
    "reward": "reward",
    "driven": "driven",
    "speed": "speed",
    "steering": "steering_angle",
    "slip": "slip",
}


def fifth_of(episodes: "pd.DataFrame") -> "pd.Series[Any]":
    """1 to 5, or 0 if unknown."""
    import pandas as pd

    first = episodes["quintile"].astype(str).str[0]
    return pd.to_numeric(first, errors="coerce").fillna(0).astype(int)


def _ends(
    steps: "pd.DataFrame",
    episodes: "pd.DataFrame",
    shown: Sequence[int],
    bounds: list[float],
    statuses: list[str],
) -> dict[str, object]:
    """Of very many, the shown laps and some, evenly over the training."""
    every = math.ceil(len(episodes) / _MOST_ENDS)
    if every > 1:
        kept = np.zeros(len(episodes), bool)
        kept[::every] = True
        episodes = episodes[kept | episodes.index.isin(shown)]
    last = steps.drop_duplicates("unique_episode", keep="last").set_index("unique_episode")
    ended = episodes.loc[episodes.index.isin(last.index)]
    last = last.loc[ended.index]
    return {
        "x": quantised(last["x"], "i16", low=bounds[0], high=bounds[2]),
        "y": quantised(last["y"], "i16", low=bounds[1], high=bounds[3]),
        "status": numbers([statuses.index(str(status)) for status in ended["status"]]),
        "period": numbers(fifth_of(ended)),
        "id": numbers(ended.index),
    }
