"""The map with its controls, and tables of laps."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from drcli.analysis.report.graphs import Section
from drcli.analysis.report.lap_choice import SHOWN_AT_ONCE, LapChoice
from drcli.analysis.report.markup import (
    Content,
    Html,
    count,
    digits,
    element,
    nth,
    numbers,
    percent,
    quantised,
    seconds,
    table,
)
from drcli.analysis.run import Run, StoredEvaluation
from drcli.base.installation import lazy_imports
from drcli.records.trace import STEP_S, VIOLATIONS
from drcli.tracks.outline import outline
from drsim.arrays import Bools, Floats, Ints
from drsim.track.track import Track

with lazy_imports():
    import pandas as pd

# Speed and slip angle of a car, from its positions.


REAR_M = 0.222
"""From the rear axle to the recorded point, measured on recordings of the reference."""

LEAST_MOTION_M = 0.02
_FASTEST_MPS = 12.0
"""Three times the fastest car."""


def slip_deg(x: Floats, y: Floats, yaw_deg: Floats, first: Bools) -> Floats:
    """Slip angle within [-180, 180), positive where the car moves to the left of its nose.

    The rear axle of a car that does not slide moves where the car points. NaN where the car hardly
    moved, and in `first` rows of episodes. All have shape (n,).
    """
    slip: Floats = np.full(len(x), np.nan)
    if len(x) < 2:
        return slip
    yaw_rad = np.radians(yaw_deg)
    rear = np.stack([x - REAR_M * np.cos(yaw_rad), y - REAR_M * np.sin(yaw_rad)], axis=1)
    motion = np.diff(rear, axis=0)
    turn_deg = _wrapped(np.diff(yaw_deg))
    heading_deg = yaw_deg[:-1] + turn_deg / 2
    angle_deg = _wrapped(np.degrees(np.arctan2(motion[:, 1], motion[:, 0])) - heading_deg)
    moved = np.hypot(*motion.T) >= LEAST_MOTION_M
    slip[1:] = np.where(moved & ~first[1:], angle_deg, np.nan)
    return slip


def driven_mps(x: Floats, y: Floats, time_s: Floats, first: Bools) -> Floats:
    """Speed over ground since the step before; NaN after a jump. All have shape (n,)."""
    speed: Floats = np.full(len(x), np.nan)
    if len(x) < 2:
        return speed
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.hypot(np.diff(x), np.diff(y)) / np.diff(time_s)
    fine = ~first[1:] & np.isfinite(found) & (found >= 0.0) & (found <= _FASTEST_MPS)
    speed[1:] = np.where(fine, found, np.nan)
    return speed


def _wrapped(angle_deg: Floats) -> Floats:
    return (angle_deg + 180.0) % 360.0 - 180.0


# The laps that the map plays.


_FARTHEST = 1e5
"""Metres: beyond are damaged files."""

_FACTS = ("id", "iteration", "episode", "progress", "time", "reward")
FINISHED = "finished_after_resets"
"""A completed lap that is not clean."""

_NEWEST = 3


def lap_data(
    steps: "pd.DataFrame",
    run: Run,
    laps: LapChoice,
    trials: list["pd.DataFrame"],
    bounds: list[float],
    statuses: list[str],
    limits: dict[str, list[float]],
) -> dict[str, Any]:
    chosen = steps[steps["unique_episode"].isin(set(laps.ids))]
    parts: list[tuple[pd.DataFrame, dict[str, Any]]] = []
    groups: dict[str, list[int]] = {}
    places: dict[int, int] = {}
    frames = dict(iter(chosen.groupby("unique_episode", sort=False)))
    for number in laps.ids:
        if number in frames:
            places[number] = len(parts)
            episode = run.episodes.loc[number]
            facts_ = {"id": number, **episode[[*_FACTS[1:], "status"]]}
            parts.append((frames[number], facts_))
    groups["fastest"] = [places[number] for number in laps.fastest if number in places]
    groups["worst"] = [places[number] for number in laps.worst if number in places]
    only_worst = [lap for lap in groups["worst"] if lap not in groups["fastest"]]
    groups["both"] = groups["fastest"] + only_worst
    for index, trial_steps in enumerate(trials):
        if trial_steps.empty:
            continue
        keys = [key for key in ("stream", "worker", "episode") if key in trial_steps]
        group = groups.setdefault(f"evaluation-{index}", [])
        for number, (_, frame) in enumerate(trial_steps.groupby(keys, sort=True)):
            group.append(len(parts))
            parts.append((with_motion(frame), _trial_facts(frame, number)))
    thinned = [(_thinned(frame, laps.every), facts) for frame, facts in parts]
    together = pd.concat([frame for frame, _ in thinned]) if thinned else steps.iloc[:0]
    time_s = [_seconds(frame) for frame, _ in thinned]
    facts = [facts for _, facts in thinned]
    known = [fact["status"] if fact["status"] in statuses else "in_progress" for fact in facts]
    return {
        "steps": _columns(together, time_s, bounds, limits),
        "laps": {
            "first": numbers(np.cumsum([0, *(len(frame) for frame, _ in thinned)])),
            "status": numbers([statuses.index(status) for status in known]),
            **{name: numbers([float(fact[name]) for fact in facts]) for name in _FACTS},
        },
        "groups": groups,
        "colors": [
            *(f"fast{number % SHOWN_AT_ONCE + 1}" for number, _ in enumerate(groups["fastest"])),
            *(f"worst{number % SHOWN_AT_ONCE + 1}" for number, _ in enumerate(only_worst)),
        ],
        "every": laps.every,
        "iterations": sorted({int(fact["iteration"]) for fact in facts} - {-1}),
    }


def _trial_facts(frame: "pd.DataFrame", number: int) -> dict[str, Any]:
    progress, status = float(frame["progress"].max()), str(frame["episode_status"].iloc[-1])
    if progress >= 100.0:
        broken = frame["episode_status"].isin(VIOLATIONS).any()
        status = FINISHED if broken else "lap_complete"
    return {
        "id": -1,
        "status": status,
        "iteration": -1,
        "episode": number,
        "progress": progress,
        "time": float(frame["tstamp"].iloc[-1] - frame["tstamp"].iloc[0]) + STEP_S,
        "reward": float(frame["reward"].sum()),
    }


def _thinned(frame: "pd.DataFrame", every: int) -> "pd.DataFrame":
    if every == 1 or len(frame) <= 2:
        return frame
    rows = np.unique([*range(0, len(frame), every), len(frame) - 1])
    return frame.iloc[rows]


def _seconds(frame: "pd.DataFrame") -> Floats:
    """Never falling, whatever a damaged file says."""
    stamp = frame["tstamp"].to_numpy(np.float64)
    stamp = np.where(np.isfinite(stamp), stamp, -np.inf)
    since: Floats = np.maximum.accumulate(stamp)
    start = since[np.isfinite(since)][:1]
    return np.where(np.isfinite(since), since - (start[0] if len(start) else 0.0) + STEP_S, 0.0)


def _columns(
    steps: "pd.DataFrame",
    time_s: list[Floats],
    bounds: list[float],
    limits: dict[str, list[float]],
) -> dict[str, object]:
    seconds = np.concatenate(time_s) if time_s else np.zeros(0)
    angle = limits["steering"][1]
    fastest = steps["speed"].max()
    top = float(fastest) if math.isfinite(fastest) and fastest > 0 else 4.0
    return {
        "x": quantised(steps["x"], "i16", low=bounds[0], high=bounds[2]),
        "y": quantised(steps["y"], "i16", low=bounds[1], high=bounds[3]),
        "yaw_rad": quantised(np.radians(steps["yaw"]), "i8", low=-np.pi, high=np.pi),
        "time_s": quantised(
            seconds, "i16", low=0.0, high=max(float(seconds.max(initial=1.0)), 1.0)
        ),
        "reward": numbers(steps["reward"]),
        "progress": quantised(steps["progress"], "i16", low=-5.0, high=105.0),
        "speed": quantised(steps["speed"], "i8", low=0.0, high=top),
        "driven": quantised(steps["driven"], "i8", low=0.0, high=max(top, limits["driven"][1])),
        "steering": quantised(steps["steering_angle"], "i8", low=-angle, high=angle),
        "slip": quantised(steps["slip"], "i8", low=-45.0, high=45.0),
    }


def same_road(run: Run) -> list[StoredEvaluation]:
    if run.steps.empty:
        return []
    length_m = float(run.steps["track_len"].median())
    same = [
        evaluation
        for evaluation in run.evaluations
        if len(evaluation.steps)
        and (evaluation.world is None or run.world is None or evaluation.world == run.world)
        and abs(float(evaluation.steps["track_len"].median()) - length_m) < 0.02 * length_m
    ]
    return same[-_NEWEST:]


def located(steps: "pd.DataFrame") -> "pd.DataFrame":
    if steps.empty:
        return steps
    known = (np.abs(steps[["x", "y", "yaw"]].to_numpy(np.float64)) <= _FARTHEST).all(axis=1)
    return steps if known.all() else steps[known]


def with_motion(steps: "pd.DataFrame") -> "pd.DataFrame":
    """Adds `slip`, degrees, and `driven`, m/s over ground."""
    key = "unique_episode" if "unique_episode" in steps else "episode"
    episode = steps[key].to_numpy()
    first = np.concatenate([[True], episode[1:] != episode[:-1]])
    x, y, yaw_deg, time_s = (
        steps[name].to_numpy(np.float64) for name in ("x", "y", "yaw", "tstamp")
    )
    return steps.assign(slip=slip_deg(x, y, yaw_deg, first), driven=driven_mps(x, y, time_s, first))


# What the map of a report draws.


_CELLS_M = (0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 20.0, 100.0)
_MOST_CELLS = 3000
_MOST_ENDS = 10_000
_SHOWN_SLIP_DEG = 20.0
"""Cars of this size slide by a few degrees."""

_MARGIN_M = 0.5
FIFTHS = ("first", "second", "third", "fourth", "last")


@dataclass(frozen=True)
class _Paint:
    """What laps and areas are coloured by, with the sides of the least and the greatest value."""

    name: str
    unit: str = ""
    sides: tuple[str, str] | None = None


_PAINTS = {
    "lap": _Paint("lap"),
    "reward": _Paint("reward of a step"),
    "driven": _Paint("driven speed", "m/s"),
    "speed": _Paint("requested speed", "m/s"),
    "steering": _Paint("steering", "°", ("(right)", "(left)")),
    "slip": _Paint("slip angle", "°", ("(to its right)", "(to its left)")),
    "visits": _Paint("how often driven", "steps"),
}
_END_COLORS = {
    "lap_complete": "end1",
    "off_track": "end2",
    "crashed": "end3",
    "reversed": "end4",
    "immobilized": "end5",
}


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
        "track": None if run.track is None else outline(run.track),
        "shows": list(_shows(run).items()),
        "statuses": [
            {"name": status.replace("_", " "), "color": _END_COLORS.get(status, "edge")}
            for status in statuses
        ],
        # They make the scale of how often places are driven.
        "cells": _cells(driven, run.episodes, limits),
        "paints": {
            name: asdict(paint) | {"range": limits.get(name)} for name, paint in _PAINTS.items()
        },
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


def ground_cells(xy: Floats, size_m: float) -> tuple[Ints, Ints]:
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


_ROWS = 5


def map_section(run: Run, laps: LapChoice) -> Section:
    all_laps = len(laps.ids) == len(run.episodes)
    shown = "All laps" if all_laps else f"{len(laps.ids)} of {count(len(run.episodes))} laps"
    steps = "" if laps.every == 1 else f", with every {nth(laps.every)} step of each,"
    chosen = "" if all_laps else ": the best and the worst of the iterations, then others"
    note = f"{shown}{steps} are in this page{chosen}."
    if run.track is None:
        note += " The track is not known here, so its borders are not drawn."
    look = (
        "Look for the place where the worst laps end and compare the speed and steering of the "
        "fastest laps there; where they leave the line that pays most, the reward and the lap "
        "time disagree."
    )
    content: tuple[Content, ...] = (
        element("div", id="map"),
        element("p", note, class_="quiet"),
        element(
            "details",
            element("summary", "Laps that stand out"),
            *_lap_tables(run.episodes),
        ),
    )
    return Section("track", "On the track", "Track map", look, content)


def _shows(run: Run) -> dict[str, str]:
    shows = {"steps-0": "all steps, whole training"}
    for number, name in enumerate(FIFTHS, start=1):
        shows[f"steps-{number}"] = f"all steps, {name} fifth"
    shows |= {
        "fastest": "fastest laps",
        "worst": "worst laps of the last fifth",
        "both": "fastest and worst laps",
        "iteration": "one iteration",
    }
    shown = [each.stamp for each in same_road(run) if len(located(each.steps))]
    return shows | {
        f"evaluation-{number}": f"evaluation {stamp}" for number, stamp in enumerate(shown)
    }


def _lap_tables(episodes: "pd.DataFrame") -> list[Html]:
    full = episodes["complete"].astype(bool)
    from_start = full & (episodes["start_at"] <= 1)
    kinds: list[tuple[str, Any, str, bool]] = [
        ("Fastest clean laps", full, "time", True),
        ("Fastest clean laps from the start line", from_start, "time", True),
        ("Clean laps with the highest reward", full, "reward", False),
        ("Episodes with the highest reward", np.ones(len(episodes), bool), "reward", False),
        ("Furthest of those that did not finish", ~full, "progress", False),
    ]
    tables = []
    for title, mask, column, ascending in kinds:
        found = episodes[mask].sort_values(column, ascending=ascending, kind="stable")[:_ROWS]
        if len(found):
            tables.append(
                table(title, _HEAD, [_row(episode) for _, episode in found.iterrows()], texts=0)
            )
    return tables


_HEAD = (
    "iteration",
    "episode",
    "progress",
    "time (s)",
    "steps",
    "start at",
    "mean speed (m/s)",
    "reward",
    "reward per step",
    "end",
)


def _row(episode: Any) -> list[Content]:
    steps = max(float(episode["steps"]) - 1, 1.0)
    return [
        str(int(episode["iteration"])),
        str(int(episode["episode"])),
        percent(episode["progress"]),
        seconds(episode["time"]),
        count(episode["steps"]),
        count(episode["start_at"]),
        digits(episode["speed"]),
        digits(episode["reward"]),
        digits(episode["reward"] / steps),
        str(episode["status"]).replace("_", " "),
    ]
