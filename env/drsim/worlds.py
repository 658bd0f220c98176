"""The worlds by name: our own definitions, and route files that the user brings."""

import difflib
import json
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drsim.errors import TrackError
from drsim.spline import ClosedSpline
from drsim.track import Track

Floats = NDArray[np.float64]

_DEFINITIONS = Path(__file__).parent / "assets" / "worlds"

_DUPLICATE_M = 1e-9
"""Neighbouring centre points nearer than this count as one. Source: the reference simulator."""

_MIN_ROWS = 4
"""Fewest rows that make a loop: a triangle and the closing row."""

_MAX_BYTES = 1_000_000
"""Far beyond any route (the longest of the reference simulator takes 19 kB); a larger file is
something else."""

_FURTHEST_M = 1e6
"""Coordinates beyond this are no track; their squares would drown in rounding."""


def load_track(world: str, tracks_dir: Path | None = None) -> Track:
    """The track of a world.

    Args:
        world: Name of one of our own definitions, path to a route file that ends in `.npy`, or
            name of such a file in `tracks_dir`, in this order.
        tracks_dir: Folder with further route files.

    Raises:
        TrackError: There is no such world, or its numbers make no track. The sentence says what
            to do.
    """
    if world.endswith(".npy"):
        return _read_route(Path(world))
    for folder, suffix, read in (
        (_DEFINITIONS, ".json", _build),
        (tracks_dir, ".npy", _read_route),
    ):
        # Asking the listing, not the file system: a world name is no path.
        if folder is not None and world in _names(folder, suffix):
            return read(folder / f"{world}{suffix}")
    raise TrackError(_unknown(world, tracks_dir))


def known_worlds(tracks_dir: Path | None = None) -> list[str]:
    """Names that `load_track` accepts, sorted.

    Args:
        tracks_dir: Folder with further route files; one that does not exist holds none.
    """
    names = _names(_DEFINITIONS, ".json")
    if tracks_dir is not None:
        names |= _names(tracks_dir, ".npy")
    return sorted(names)


def _names(folder: Path, suffix: str) -> set[str]:
    return {file.name.removesuffix(suffix) for file in folder.glob(f"*{suffix}")}


def _unknown(world: str, tracks_dir: Path | None) -> str:
    known = known_worlds(tracks_dir)
    by_lower = {name.lower(): name for name in known}
    close = difflib.get_close_matches(world.lower(), by_lower, n=5, cutoff=0.5)
    names = [by_lower[name] for name in close] or known[:5]
    hint = "the closest names are" if close else "known are for instance"
    where = f"put {world}.npy into {tracks_dir}" if tracks_dir else f"give the path to {world}.npy"
    return f"No world is called '{world}'; {hint} {', '.join(names)}. Use one of them, or {where}."


def _build(definition: Path) -> Track:
    """The track of one of our own definitions.

    Waypoints stand at even distances along a closed spline, except for a few that are shifted
    along it: racers write waypoint numbers into their reward functions, and the route they know
    is uneven there.
    """
    numbers = json.loads(definition.read_text(encoding="utf-8"))
    spline = ClosedSpline(np.array(numbers["control_points_m"], dtype=np.float64))
    distance_m = np.linspace(0.0, spline.length_m, numbers["waypoints"], endpoint=False)
    for waypoint, shift_m in numbers["shifted_waypoints_m"].items():
        distance_m[int(waypoint)] += shift_m
    center, direction = spline.at(distance_m)
    to_left = np.stack([-direction[:, 1], direction[:, 0]], axis=1) * numbers["width_m"] / 2
    rows = np.concatenate([center, center + to_left, center - to_left], axis=1)
    track = _track(definition.stem, np.concatenate([rows, rows[:1]]))
    if track.is_ccw:  # then the inside of the loop lies to the left, as built
        return track
    return Track(track.name, track.center, track.outer, track.inner, track.closed)


def _read_route(file: Path) -> Track:
    """The track of a route file, checked and cleaned.

    Source of the format: the reference simulator's route files, float64, shape (n, 6), metres:
    centre x and y, inner border x and y, outer border x and y, in driving order.
    """
    array = _read_array(file)
    if array.ndim != 2 or array.shape[1] != 6 or not len(array) or array.dtype.kind not in "fiu":
        raise TrackError(
            f"{file} holds an array of shape {array.shape} and type {array.dtype}, but a route has "
            "6 columns of numbers: centre x y, inner x y, outer x y. Export the route again."
        )
    rows = np.ascontiguousarray(array, dtype=np.float64)
    wrong = np.flatnonzero(~(np.abs(rows) <= _FURTHEST_M).all(axis=1))
    if wrong.size:
        raise TrackError(
            f"{file} row {wrong[0]} holds {rows[wrong[0]].tolist()}: every value must be a finite "
            f"number of metres within {_FURTHEST_M:.0e}. Correct or remove that row."
        )
    rows = _without_duplicates(rows)
    if len(rows) < _MIN_ROWS:
        raise TrackError(
            f"{file} has {len(rows)} distinct rows; a track needs at least {_MIN_ROWS}. "
            "Export the route again."
        )
    track = _track(file.stem, rows)
    if np.mean(track.on_road(track.center[1:-1])) < 0.5:  # a stray point or two is the user's road
        raise TrackError(
            f"{file}: most centre points do not lie between the borders. Columns are centre x y, "
            "inner x y, outer x y, and inner is the border inside the loop. Export the route again."
        )
    return track


def _read_array(file: Path) -> NDArray[np.generic]:
    try:
        if not file.is_file():  # a folder or a pipe would fail or block below
            raise FileNotFoundError
        with file.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
    except FileNotFoundError:
        raise TrackError(f"There is no route file {file}. Correct the path.") from None
    except OSError as error:
        raise TrackError(
            f"{file} cannot be read ({error.strerror}). Correct the path or its rights."
        ) from None
    if len(data) > _MAX_BYTES:
        raise TrackError(
            f"{file} is larger than {_MAX_BYTES} bytes, which no route is. Name another file, or "
            "resample the route to one row every 0.3 m."
        )
    try:
        array: NDArray[np.generic] = np.lib.format.read_array(BytesIO(data), allow_pickle=False)
    except Exception as error:  # on foreign bytes numpy's header parser raises nearly any kind
        raise TrackError(
            f"{file} is no route file ({error}). Save it again with numpy.save, as an array of "
            "6 columns of float64."
        ) from None
    return array


def _without_duplicates(rows: Floats) -> Floats:
    """Rows whose centre point differs from that of the row kept before; the last row stays."""
    kept = [0]
    for k in range(1, len(rows)):
        if np.hypot(*(rows[k, :2] - rows[kept[-1], :2])) > _DUPLICATE_M:
            kept.append(k)
    if len(kept) > 1:
        kept[-1] = max(kept[-1], len(rows) - 1)
    return rows[kept]


def _track(name: str, rows: Floats) -> Track:
    closed = bool(np.abs(rows[0] - rows[-1]).max() <= _DUPLICATE_M)
    if closed:
        rows[-1] = rows[0]
    center, inner, outer = (rows[:, k : k + 2].copy() for k in (0, 2, 4))
    return Track(name, center, inner, outer, closed)
