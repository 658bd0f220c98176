"""Route files: the user's tracks as .npy, .csv or .svg."""

from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Floats
from drsim.errors import TrackError
from drsim.track import svg_file
from drsim.track.borders import LENGTHS_M, checked_length, road_along
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
        widths_m = rows[:, 2]
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
                continue
            raise TrackError(f"line {number}: {error}. Correct or remove that line.") from None
        if rows and len(row) != len(rows[0]):
            raise TrackError(
                f"line {number} has {len(row)} values, the lines before it {len(rows[0])}. "
                "Correct or remove that line."
            )
        rows.append(row)
    return np.array(rows, dtype=np.float64)


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


def _bordered(name: str, rows: Floats, length_m: float | None) -> Track:
    if length_m is not None:
        rows = rows * (checked_length(length_m) / np.hypot(*np.diff(rows[:, :2], axis=0).T).sum())
    closed = bool(np.abs(rows[0] - rows[-1]).max() <= SAME_M)
    if closed:
        rows[-1] = rows[0]
    center, inner, outer = (rows[:, k : k + 2].copy() for k in (0, 2, 4))
    track = Track(name, center, inner, outer, closed)
    if np.mean(track.on_road(track.center[1:-1])) < 0.5:  # a stray point or two is the user's road
        raise TrackError(
            "most centre points do not lie between the borders. Columns are centre x y, "
            "inner x y, outer x y, and inner is the border inside the loop. Export the route again."
        )
    return track
