"""Places along the track for objects that keep a distance."""

import numpy as np

from drsim.arrays import Floats
from drsim.track.track import Track

LAST_PLACE_M = 1.0
"""Before the end of the lap. Source: the reference simulator."""

FREE_START_M = 1.0
MOST_OBJECTS = 100


def check_room(track: Track, count: int, gap_m: float) -> None:
    """Raise ValueError if so many objects do not fit on a track."""
    fit = most_that_fit(track, gap_m)
    if count > fit:
        raise ValueError(
            f"{count} objects at least {gap_m:g} m apart are too many for {track.name}, which is "
            f"{track.length_m:.1f} m long: {fit} would fit."
        )


def most_that_fit(track: Track, gap_m: float) -> int:
    """A single one always can."""
    room_m = track.length_m - LAST_PLACE_M
    if room_m >= MOST_OBJECTS * gap_m:
        return MOST_OBJECTS
    return max(int(room_m / gap_m + 1e-9), 1)


def even_places(track: Track, count: int, gap_m: float) -> Floats:
    """Metres along the lap, from the gap itself to a metre before the end. Shape (count,).

    Source: the reference simulator, but for its gap, which was a percentage.
    """
    last_m = max(track.length_m - LAST_PLACE_M, 0.0)
    return np.linspace(min(gap_m, last_m), last_m, count)


def drawn_places(
    track: Track, count: int, gap_m: float, start_m: float, random: np.random.Generator
) -> Floats:
    """Metres along the lap, drawn evenly among all places that keep the gap, also across its end.

    In driving order from the start, which stays free; `count` objects must fit.
    """
    length_m = track.length_m
    taken_m = max(count - 1, 0) * gap_m
    if track.closed:
        free_m = min(max(FREE_START_M, gap_m / 2), (length_m - taken_m) / 2)
        room_m = length_m - taken_m - 2 * free_m
        first_m = start_m + free_m
    else:
        first_m = min(FREE_START_M, length_m - taken_m)
        room_m = max(length_m - LAST_PLACE_M - taken_m - first_m, 0.0)
    places_m = first_m + np.sort(random.uniform(0.0, room_m, count)) + gap_m * np.arange(count)
    return places_m % length_m if track.closed else np.minimum(places_m, length_m)
