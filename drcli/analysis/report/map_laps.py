"""The laps that the map plays."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drcli.analysis.report.car_motion import driven_mps, slip_deg
from drcli.analysis.report.lap_choice import LapChoice
from drcli.analysis.report.packing import numbers, quantised
from drcli.analysis.run import Run, StoredEvaluation
from drcli.exchange.trace import STEP_S, VIOLATIONS

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]

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
    import pandas as pd

    chosen = steps[steps["unique_episode"].isin(set(laps.ids))]
    parts: list[tuple[pd.DataFrame, dict[str, Any]]] = []
    groups: dict[str, list[int]] = {}
    places: dict[int, int] = {}
    frames = dict(iter(chosen.groupby("unique_episode", sort=False)))
    for number in laps.ids:
        if number in frames:
            places[number] = len(parts)
            parts.append((frames[number], _lap_facts(run.episodes.loc[number], number)))
    groups["fastest"] = [places[number] for number in laps.fastest if number in places]
    groups["worst"] = [places[number] for number in laps.worst if number in places]
    groups["both"] = list(dict.fromkeys(groups["fastest"] + groups["worst"]))
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
    }


def _lap_facts(episode: Any, number: int) -> dict[str, Any]:
    return {"status": str(episode["status"]), "id": number} | {
        name: episode[name] for name in _FACTS[1:]
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
        "yaw": quantised(steps["yaw"], "i8", low=-180.0, high=180.0),
        "time": quantised(seconds, "i16", low=0.0, high=max(float(seconds.max(initial=1.0)), 1.0)),
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


def evaluations_on_the_map(run: Run) -> list[str]:
    return [evaluation.stamp for evaluation in same_road(run) if len(located(evaluation.steps))]
