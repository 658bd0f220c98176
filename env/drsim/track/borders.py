"""A road of given width along a centre line, without loops in sharp bends."""

import numpy as np

from drsim.arrays import Bools, Floats
from drsim.errors import TrackError
from drsim.track.track import Track

SPACING_M = 0.2
"""Most routes of the reference simulator have 0.15 or 0.3 m."""

LENGTHS_M = (2.0, 1000.0)
"""The longest of the reference simulator is 89 m."""

WIDTHS_M = (0.25, 20.0)
_BEND_WIDTHS = 4.0
_PARALLEL_M2 = 1e-12
"""Less is rounding."""


def road_along(name: str, center: Floats, width_m: Floats, length_m: float | None = None) -> Track:
    """The road along a centre line, a loop if its ends meet within one road width.

    `center` is in driving order, in metres, or in any unit if it is scaled to `length_m`; shape
    (k, 2). Waypoints then stand about `SPACING_M` apart.

    Raises:
        TrackError: The road is too short, too long, too narrow or too wide, or crosses itself.
    """
    narrowest_m, widest_m = WIDTHS_M
    wrong = np.flatnonzero(~((width_m >= narrowest_m) & (width_m <= widest_m)))
    if wrong.size:
        raise TrackError(
            f"the road is {width_m[wrong[0]]:g} m wide at point {wrong[0]}, but it must be between "
            f"{narrowest_m:g} and {widest_m:g} m wide. Correct the width; its unit is metres."
        )
    if length_m is not None:
        center = center * (checked_length(length_m) / _length(center))
    center, width_m, closed = _closed(center, width_m)
    center, width_m = _resampled(center, width_m, closed)
    if length_m is not None:  # chords between waypoints are a little shorter than the line was
        center *= length_m / _length(center)
    left, right = (_beside(center, side * width_m / 2, closed) for side in (1, -1))
    counter_clockwise = not closed or _area(center) > 0
    inner, outer = (left, right) if counter_clockwise else (right, left)
    track = Track(name, center, inner, outer, closed)
    _check_apart(track)
    return track


def checked_length(length_m: float) -> float:
    """TrackError if it is NaN, too short or too long."""
    shortest_m, longest_m = LENGTHS_M
    if not shortest_m <= length_m <= longest_m:
        raise TrackError(
            f"the centre line would be {length_m:g} m long, but a track has {shortest_m:g} to "
            f"{longest_m:g} m. Coordinates are metres; give length_m if those of the file are not."
        )
    return length_m


def _length(line: Floats) -> float:
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    if not length > 0:
        raise TrackError("all points of the centre line are the same. Draw the track again.")
    return length


def _closed(center: Floats, width_m: Floats) -> tuple[Floats, Floats, bool]:
    whole_m = checked_length(_length(center))
    gap_m = np.hypot(*(center[-1] - center[0]))
    if gap_m > width_m[0] or whole_m < 3 * width_m[0]:
        return center, width_m, False
    # A loop drawn by hand may run past its start: those points would lead back to it.
    onward = center[1] - center[0]
    last = len(center)
    while last > 3:
        past = center[last - 1] - center[0]
        if past @ onward < 0 or np.hypot(*past) > width_m[0]:
            break
        last -= 1
    return (
        np.concatenate([center[:last], center[:1]]),
        np.concatenate([width_m[:last], width_m[:1]]),
        True,
    )


def _resampled(center: Floats, width_m: Floats, closed: bool) -> tuple[Floats, Floats]:
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(center, axis=0).T))])
    rows = round(along_m[-1] / SPACING_M) + 1
    at_m = np.linspace(0.0, along_m[-1], rows)
    x, y, width = (np.interp(at_m, along_m, values) for values in (*center.T, width_m))
    even = np.stack([x, y], axis=1)
    if closed:
        even[-1] = even[0]
    return even, width


def _beside(center: Floats, left_m: Floats, closed: bool) -> Floats:
    if closed:
        around = np.concatenate([center[-2:-1], center, center[1:2]])
        onward = around[2:] - around[:-2]
    else:
        onward = np.gradient(center, axis=0)
    step_m = np.hypot(*onward.T)
    if not step_m.min() > 1e-6:
        k = int(step_m.argmin())
        raise TrackError(
            f"the centre line turns back on itself at {_place(center[k])}. Draw that bend wider."
        )
    normal = np.stack([-onward[:, 1], onward[:, 0]], axis=1) / step_m[:, None]
    line = center + normal * left_m[:, None]
    if not closed:
        return _without_loops(line, left_m, closed)
    line = _without_loops(line[:-1], left_m, closed)
    return np.concatenate([line, line[:1]])


def _without_loops(line: Floats, left_m: Floats, closed: bool) -> Floats:
    """The line, cut short where it crosses itself inside a bend."""
    n = len(line)
    window = min(n // 2, round(_BEND_WIDTHS * 2 * np.abs(left_m).max() / SPACING_M))
    cut = line.copy()
    k = 0
    while k < (n if closed else n - 1):
        start, end = cut[k], cut[(k + 1) % n]
        later = np.arange(k + 2, k + window + 1)
        later = later % n if closed else later[later < n - 1]
        starts, ends = line[later], line[(later + 1) % n]
        hits = np.flatnonzero(_crossed(start, end, starts, ends, touching=True))
        if hits.size:
            last = hits[-1]
            rows = np.arange(k + 1, k + 1 + last + 2)
            cut[rows % n] = _crossing(start, end, starts[last], ends[last])
            k += last + 2
        else:
            k += 1
    return cut


def _crossed(a: Floats, b: Floats, c: Floats, d: Floats, *, touching: bool) -> Bools:
    """No parallel one.

    With `touching`, an end on the other segment lies to the right of it, so that a line through a
    vertex crosses once.
    """
    ab, cd = b - a, d - c
    sides = _cross(ab, c - a), _cross(ab, d - a), _cross(cd, a - c), _cross(cd, b - c)
    if touching:
        c_left, d_left, a_left, b_left = (side > 0 for side in sides)
        apart = (c_left != d_left) & (a_left != b_left)
    else:
        apart = (sides[0] * sides[1] < 0) & (sides[2] * sides[3] < 0)
    result: Bools = apart & (np.abs(_cross(ab, cd)) > _PARALLEL_M2)
    return result


def _crossing(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    share = _cross(c - a, d - c) / _cross(b - a, d - c)
    return a + share * (b - a)


def _cross(u: Floats, v: Floats) -> Floats:
    result: Floats = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    return result


def _area(ring: Floats) -> float:
    local = ring - ring[0]
    return float(_cross(local[:-1], local[1:]).sum())


def _check_apart(track: Track) -> None:
    starts = np.concatenate([track.inner[:-1], track.outer[:-1]])
    ends = np.concatenate([track.inner[1:], track.outer[1:]])
    for k, (start, end) in enumerate(zip(starts, ends, strict=True)):
        hits = _crossed(start, end, starts[k + 1 :], ends[k + 1 :], touching=False)
        if hits.any():
            raise TrackError(
                f"the borders of the road cross at {_place(start)}. Give a smaller width_m, or "
                "draw the track with wider bends and its stretches further apart."
            )
    outside = np.flatnonzero(~track.on_road(track.center[1:-1]))
    if outside.size:
        raise TrackError(
            f"the road overlaps itself at {_place(track.center[1 + outside[0]])}. Give a smaller "
            "width_m, or draw the track with wider bends and its stretches further apart."
        )


def _place(xy: Floats) -> str:
    return f"x = {xy[0]:.2f} m, y = {xy[1]:.2f} m"
