"""Finds the track of a training, by files or driven positions."""

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drcli.base.errors import DrError
from drsim.arrays import Floats
from drsim.errors import TrackError
from drsim.track.track import Track
from drsim.track.worlds import known_worlds, load_track

if TYPE_CHECKING:
    import pandas as pd

LENGTH_TOLERANCE = 0.02
NEAR_M = 0.5
"""Waypoints are 0.3 m apart, the road is 0.6 to 1.5 m wide."""

_SAMPLES = 2000

_WORLD = re.compile(r"^\s*['\"]?WORLD_NAME['\"]?\s*:\s*['\"]?([^'\",\s]+)", re.MULTILINE)
_LOG_WORLD = re.compile(r"(?:/WORLD_NAME: |'WORLD_NAME': ')([\w.-]+)")


def world_in_parameters(text: str) -> str | None:
    """The track in training_params.yaml or evaluation_params.yaml."""
    found = _WORLD.search(text)
    if found is None:
        return None
    first = found[1].strip("[]- ")
    return first or None


def world_in_log(text: str) -> str | None:
    found = _LOG_WORLD.search(text)
    return found[1] if found else None


def open_track(world: str, folder: Path) -> Track | None:
    """The installed track of this name, which may not be a path: files come from strangers."""
    if "/" in world or "\\" in world:
        return None
    try:
        return load_track(world, folder)
    except (TrackError, DrError, OSError):
        return None


def directed_as_driven(track: Track, steps: "pd.DataFrame") -> Track | None:
    """A track in the direction of the steps; None if they were driven elsewhere."""
    sample = _sample(steps)
    if not len(sample):
        return track
    turned = track.reversed()
    forward, backward = _distances(track, sample), _distances(turned, sample)
    if forward is None or backward is None:
        return None
    # Where the direction alternates, each fits a part of the steps.
    if float(np.median(np.minimum(forward, backward))) > NEAR_M:
        return None
    return turned if np.median(backward) < np.median(forward) else track


def fitting_track(steps: "pd.DataFrame", folder: Path) -> Track | None:
    """The first known track that steps were driven on, or None."""
    sample = _sample(steps)
    best: tuple[float, Track] | None = None
    for world in known_worlds(folder):
        track = open_track(world, folder)
        if track is None:
            continue
        for candidate in (track, track.reversed()):
            misfit = _misfit(candidate, sample)
            # Routes that hardly differ are the same track on other ground.
            if misfit is not None and (best is None or misfit < 0.98 * best[0]):
                best = misfit, candidate
    return best[1] if best else None


def _sample(steps: "pd.DataFrame") -> "pd.DataFrame":
    return steps.iloc[:: max(1, len(steps) // _SAMPLES)]


def _misfit(track: Track, sample: "pd.DataFrame") -> float | None:
    distances_m = _distances(track, sample)
    if distances_m is None:
        return None
    median_m = float(np.median(distances_m))
    return median_m if median_m <= NEAR_M else None


def _distances(track: Track, sample: "pd.DataFrame") -> Floats | None:
    if not len(sample):
        return None
    length_m = float(np.hypot(*np.diff(track.center, axis=0).T).sum())
    told_m = float(sample["track_len"].median())
    if abs(told_m - length_m) > LENGTH_TOLERANCE * length_m:
        return None
    waypoints = sample["closest_waypoint"].to_numpy()
    if waypoints.max() >= len(track.center):
        return None
    x, y = (sample[["x", "y"]].to_numpy(float) - track.center[waypoints]).T
    return np.asarray(np.hypot(x, y))
