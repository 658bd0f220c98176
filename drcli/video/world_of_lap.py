"""Finds a trace's track by its laps."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drcli.base.errors import SettingsError
from drcli.video.recorded_lap import RecordedLap
from drsim.errors import TrackError
from drsim.track.track import Track
from drsim.track.worlds import known_worlds, load_track

SAME_LENGTH = 0.002
"""Tolerance as a share: a trace counts centimetres."""

LEAST_ON_ROAD = 0.6
"""Share of rows: beginners' models leave the road, but not for long."""


def load_world(name: str, folder: Path | None) -> Track:
    """Raises SettingsError for a missing or damaged track."""
    try:
        return load_track(name, folder)
    except TrackError as error:
        raise SettingsError(
            f"The track {name:.80} cannot be shown: {error}",
            remedy="Fetch it with `dr-tracks fetch NAME`, or name another one with --world.",
        ) from None


def find_world(laps: Sequence[RecordedLap], first: str, folder: Path | None, origin: str) -> Track:
    """The track that the laps fit on; tries `first` first.

    Raises:
        SettingsError: They fit on none.
    """
    points = np.concatenate([lap.poses[:, :2] for lap in laps])
    points = points[:: max(1, len(points) // 2000)]
    length_m = next((lap.track_length_m for lap in laps if lap.track_length_m > 0), math.nan)
    best, best_share = None, 0.0
    for name in dict.fromkeys([first, *known_worlds(folder)]):
        try:
            track = load_track(name, folder)
        except TrackError:
            continue
        if abs(track.length_m - length_m) > max(SAME_LENGTH * track.length_m, 0.02):
            continue
        share = float(track.on_road(points).mean())
        if share > best_share and share >= LEAST_ON_ROAD:
            best, best_share = track, share
        if share > 0.98:
            break
    if best is None:
        text = "" if math.isnan(length_m) else f" of {length_m:.2f} m"
        raise SettingsError(
            f"{origin} does not name its track, and no installed one{text} fits it.",
            remedy="Name the track with --world; `dr-tracks list` shows what is installed, and "
            "`dr-tracks fetch NAME` brings others.",
        )
    return best
