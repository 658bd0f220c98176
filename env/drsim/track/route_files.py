"""Route files: the user's tracks as .npy, .csv or .svg."""

import re
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Bools, Floats
from drsim.errors import TrackError
from drsim.track import svg_file
from drsim.track.polyline import SAME_M, vertices
from drsim.track.track import Track

DEFAULT_WIDTH_M = 1.07
"""3.5 feet, as on 97 of the reference simulator's 127 tracks."""

_MIN_ROWS = 4
_MAX_BYTES = 1_000_000
_FURTHEST_M = 1e6
"""Beyond, rounding would swallow the track."""

_CHORD_M = 0.05
_COLUMNS = "centre x y; or centre x y, width; or centre x y, inner x y, outer x y"


def read_route(
    file: Path,
    *,
    name: str | None = None,
    width_m: float | None = None,
    length_m: float | None = None,
) -> Track:
    """The track of a route file, checked.

    - `.npy`: an array of 2, 3 or 6 columns. Source of the format with 6: the reference simulator's
      route files, float64, metres, centre x and y, inner border x and y, outer border x and y, in
      driving order.
    - `.csv`: the same as text, with or without headings, separated by commas or semicolons.
    - `.svg`: the first path, polyline or polygon is the centre line; `length_m` is needed.

    With 6 columns every row is a waypoint, also a repeated one: racers count rows. Otherwise
    waypoints are spread evenly. Default width: the file's, else 1.07 m.

    Raises:
        TrackError: The file does not exist or is not a track.
    """
    try:
        return _read(file, name or file.stem, width_m, length_m)
    except TrackError as refusal:
        raise TrackError(f"{file}: {refusal}") from None


def write_route(track: Track, file: Path) -> None:
    """Save a track as a route file that `read_route` reads back the same, or replace one.

    Raises:
        TrackError: The file cannot be written, or its name does not end in .npy.
    """
    if file.suffix != ".npy":
        raise TrackError(f"{file}: routes are saved as .npy. End the name of the file in .npy.")
    rows = np.concatenate([track.center, track.inner, track.outer], axis=1)
    try:
        with file.open("wb") as stream:
            np.save(stream, rows, allow_pickle=False)
    except (OSError, ValueError) as error:  # the second: a name with a null byte
        raise TrackError(
            f"{file}: it cannot be written ({error}). Correct the path or its permissions."
        ) from None


def _read(file: Path, name: str, width_m: float | None, length_m: float | None) -> Track:
    suffix = file.suffix.lower()
    if suffix not in (".npy", ".csv", ".svg"):
        raise TrackError("a route file ends in .npy, .csv or .svg. Save the route as one of them.")
    data = _bytes_of(file)
    if suffix == ".svg":
        rows = _drawn(_text(data), length_m)
    else:
        rows = _checked(_array(data) if suffix == ".npy" else _table(_text(data)))
    if rows.shape[1] == 6 and width_m is None:
        return _bordered(name, rows, length_m)
    first, _ = vertices(rows[:, :2])
    rows = rows[first]
    if width_m is not None:
        widths_m = np.full(len(rows), float(width_m))
    elif rows.shape[1] == 3:
        widths_m = _widths_of_road(rows[:, 2])
    else:
        widths_m = np.full(len(rows), DEFAULT_WIDTH_M)
    return road_along(name, rows[:, :2], widths_m, length_m)


def _bytes_of(file: Path) -> bytes:
    try:
        if not file.is_file():  # a folder or a pipe would fail or block below
            raise FileNotFoundError
        with file.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
    except FileNotFoundError:
        raise TrackError("the route file does not exist. Correct the path.") from None
    except OSError as error:
        raise TrackError(
            f"it cannot be read ({error.strerror}). Correct the path or its permissions."
        ) from None
    if len(data) > _MAX_BYTES:
        raise TrackError(
            f"it is larger than {_MAX_BYTES} bytes, far more than a route needs. Choose another "
            "file, or resample the route to one row every 0.3 m."
        )
    return data


def _text(data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise TrackError(
            f"byte {error.start} is not UTF-8 text. Save the file again as UTF-8."
        ) from None


def _drawn(text: str, length_m: float | None) -> Floats:
    if length_m is None:
        raise TrackError(
            "a drawing has no unit. Give length_m, the length of the centre line; the length of "
            "a DeepRacer track is 15 to 90 m."
        )
    # A length out of range is refused later, with all other lengths.
    return svg_file.read_line(text, round(float(np.clip(length_m, *LENGTHS_M)) / _CHORD_M))


def _array(data: bytes) -> NDArray[np.generic]:
    try:
        array: NDArray[np.generic] = np.lib.format.read_array(BytesIO(data), allow_pickle=False)
    except Exception as error:  # on foreign bytes numpy's header parser raises nearly any kind
        raise TrackError(
            f"this is not a route file ({error}). Save it again with numpy.save, as an array of "
            "6 columns of float64."
        ) from None
    return array


def _table(text: str) -> Floats:
    lines = [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    separator = ";" if any(";" in line for _, line in lines[:2]) else ","
    rows: list[list[float]] = []
    for k, (number, line) in enumerate(lines):
        fields = line.split(separator)
        if separator == ";":  # as spreadsheets write where the comma is the decimal sign
            fields = [field.replace(",", ".") for field in fields]
        try:
            row = [float(field) for field in fields]
        except ValueError as error:
            if k == 0:  # headings
                _refuse_speeds(fields)
                continue
            raise TrackError(f"line {number}: {error}. Correct or remove that line.") from None
        if rows and len(row) != len(rows[0]):
            raise TrackError(
                f"line {number} has {len(row)} values, the lines before it {len(rows[0])}. "
                "Correct or remove that line."
            )
        rows.append(row)
    return np.array(rows, dtype=np.float64)


def _refuse_speeds(headings: list[str]) -> None:
    if len(headings) == 3 and re.match(r"\W*(speed|velocity|v\b|throttle)", headings[2].lower()):
        raise TrackError(
            f"the third column is called {headings[2].strip()[:40]}, but there a route has the "
            "width of the road. Remove that column, and give width_m if the road is not "
            f"{DEFAULT_WIDTH_M} m wide."
        )


def _checked(array: NDArray[np.generic]) -> Floats:
    if (
        array.ndim != 2
        or array.shape[1] not in (2, 3, 6)
        or not len(array)
        or array.dtype.kind not in "fiu"
    ):
        raise TrackError(
            f"it contains an array of shape {array.shape} and type {array.dtype}, but a route has "
            f"2, 3 or 6 columns of numbers: {_COLUMNS}. Export the route again."
        )
    rows = np.ascontiguousarray(array, dtype=np.float64)
    wrong = np.flatnonzero(~(np.abs(rows) <= _FURTHEST_M).all(axis=1))
    if wrong.size:
        raise TrackError(
            f"row {wrong[0]} contains {rows[wrong[0]].tolist()}: every value must be a finite "
            f"number of metres within {_FURTHEST_M:.0e}. Correct or remove that row."
        )
    distinct = len(vertices(rows[:, :2])[0])
    if distinct < _MIN_ROWS:
        raise TrackError(
            f"it has {distinct} distinct rows; a track needs at least {_MIN_ROWS}. "
            "Export the route again."
        )
    return rows


def _widths_of_road(column: Floats) -> Floats:
    """The third column, which racing lines use for speeds."""
    narrowest_m, widest_m = WIDTHS_OF_FILES_M
    least, greatest = column.min(), column.max()
    if not (narrowest_m <= least and greatest <= min(widest_m, _MOST_UNEVEN * least)):
        raise TrackError(
            f"the third column has values from {least:g} to {greatest:g}, but there it is the "
            f"width of the road, {narrowest_m:g} to {widest_m:g} m and much the same everywhere. A "
            "racing line with speeds is no track; if its points are the middle of the road, give "
            "width_m."
        )
    return column


def _bordered(name: str, rows: Floats, length_m: float | None) -> Track:
    if length_m is not None:
        rows = rows * (checked_length(length_m) / np.hypot(*np.diff(rows[:, :2], axis=0).T).sum())
    rows, closed, joined_m = _joined(rows)
    center, inner, outer = (rows[:, k : k + 2].copy() for k in (0, 2, 4))
    track = Track(name, center, inner, outer, closed, joined_m=joined_m)
    if np.mean(track.on_road(track.center[1:-1])) < 0.5:  # a stray point or two is the user's road
        raise TrackError(
            "most centre points do not lie between the borders. Columns are centre x y, "
            "inner x y, outer x y, and inner is the border inside the loop. Export the route again."
        )
    return track


_SLIP_M = 0.01
"""Closer ends are the same point, written with few digits."""


def _joined(rows: Floats) -> tuple[Floats, bool, float]:
    """A loop ends with its first row; a gap narrower than the road is closed, and returned."""
    first, _ = vertices(rows[:, :2])
    gap = rows[0, :2] - rows[-1, :2]
    gap_m = float(np.hypot(*gap))
    width_m = float(np.hypot(*(rows[0, 4:] - rows[0, 2:4])))
    length_m = float(np.hypot(*np.diff(rows[:, :2], axis=0).T).sum())
    if gap_m > SAME_M and (gap_m >= width_m or length_m < 3 * width_m):
        return rows, False, 0.0
    if gap_m <= _SLIP_M:
        return np.concatenate([rows[:-1], rows[:1]]), True, 0.0
    if gap @ (rows[first[-1], :2] - rows[first[-2], :2]) < 0:
        raise TrackError(
            f"its last row lies {gap_m:.2f} m behind its first one, closer than the road is wide. "
            "Remove the rows at the end that run past the first one."
        )
    return np.concatenate([rows, rows[:1]]), True, gap_m


SPACING_M = 0.2
"""Most routes of the reference simulator have 0.15 or 0.3 m."""

LENGTHS_M = (2.0, 1000.0)
"""The longest of the reference simulator is 89 m."""

WIDTHS_M = (0.25, 20.0)
WIDTHS_OF_FILES_M = (0.3, 3.0)
_MOST_UNEVEN = 2.0
"""Widest by narrowest road; speeds along a racing line differ more."""

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
    gap_m = float(np.hypot(*(center[-1] - center[0])))
    center, width_m, closed = _closed(center, width_m)
    center, width_m = _resampled(center, width_m, closed)
    if length_m is not None:  # chords between waypoints are a little shorter than the line was
        center *= length_m / _length(center)
    left, right = (_beside(center, side * width_m / 2, closed) for side in (1, -1))
    inner, outer = (left, right) if (not closed or _area(center) > 0) else (right, left)
    track = Track(name, center, inner, outer, closed, joined_m=gap_m if closed else 0.0)
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
    return np.asarray(apart & (np.abs(_cross(ab, cd)) > _PARALLEL_M2))


def _crossing(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    share = _cross(c - a, d - c) / _cross(b - a, d - c)
    return a + share * (b - a)


def _cross(u: Floats, v: Floats) -> Floats:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


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
