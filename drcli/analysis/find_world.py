"""Finds the track of a training: by what its files say, else by where its car drove."""

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
"""Greatest relative difference of a trace's track_len and the centre line of its track."""

NEAR_M = 0.5
"""The car is nearer than this to its closest waypoint in most rows: waypoints are 0.3 m apart, and
the road is 0.6 to 1.5 m wide."""

_SAMPLES = 2000

_WORLD = re.compile(r"^\s*['\"]?WORLD_NAME['\"]?\s*:\s*['\"]?([^'\",\s]+)", re.MULTILINE)
_LOG_WORLD = re.compile(r"(?:/WORLD_NAME: |'WORLD_NAME': ')([\w.-]+)")


def world_in_parameters(text: str) -> str | None:
    """The track in training_params.yaml or evaluation_params.yaml, as far as it can be read.

    A list of several, one for each car, names the same track.
    """
    found = _WORLD.search(text)
    if found is None:
        return None
    first = found[1].strip("[]- ")
    return first or None


def world_in_log(text: str) -> str | None:
    """The track in the log of a simulation."""
    found = _LOG_WORLD.search(text)
    return found[1] if found else None


def open_track(world: str, folder: Path) -> Track | None:
    """The track of this name; None if it is not installed, or not a track.

    Args:
        world: Its name. A name is all that it may be: files come from strangers.
        folder: The racer's own tracks.
    """
    if "/" in world or "\\" in world:
        return None
    try:
        return load_track(world, folder)
    except (TrackError, DrError, OSError):
        return None


def directed_as_driven(track: Track, steps: "pd.DataFrame") -> Track | None:
    """A track in the direction in which steps were driven; None if they were driven elsewhere.

    Without steps, it is the track as it is defined.
    """
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
    """The known track that steps were driven on; None if none fits.

    Of several with the same route, the first by name is taken.
    """
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
    """Median distance of the car from its closest waypoint, metres; None if it does not fit."""
    distances_m = _distances(track, sample)
    if distances_m is None:
        return None
    median_m = float(np.median(distances_m))
    return median_m if median_m <= NEAR_M else None


def _distances(track: Track, sample: "pd.DataFrame") -> Floats | None:
    """Distance of the car from its closest waypoint, metres; None if the track is another one."""
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
