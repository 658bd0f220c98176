"""Tracks by name: our own definitions, and the user's route files."""

import difflib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from drsim.arrays import Floats, Ints
from drsim.errors import TrackError
from drsim.track import zoo
from drsim.track.appearance import look_of, split_direction
from drsim.track.polyline import vertices
from drsim.track.route_files import read_route
from drsim.track.track import Track

Direction = Literal["clockwise", "counterclockwise", "open"]

_DEFINITIONS = Path(__file__).parent / "definitions"

_LONGEST_NAME = 1_000
_ROUTE_FILES = (".npy", ".csv")


class Width(NamedTuple):
    mean: float
    least: float
    greatest: float


@dataclass(frozen=True)
class WorldInfo:
    """Facts about a track.

    Attributes:
        direction: "open" if it is not a loop.
        waypoints: On a loop the last one repeats the first.
        repeated: Those that repeat the one before.
        spacing_m: On average, without these.
        line_family: "in" when the white line belongs to the road, else "out".
        source: "own", or the path of the route file.
        joined_m: As of the track.
    """

    name: str
    length_m: float
    width_m: Width
    direction: Direction
    waypoints: int
    repeated: list[int]
    spacing_m: float
    line_family: Literal["in", "out"]
    source: str
    difficulty: Literal["easy", "medium", "hard"] | None
    about: str
    joined_m: float = 0.0


def load_track(world: str, tracks_dir: Path | None = None) -> Track:
    """The track of a world.

    Args:
        world: One of these, in this order:

            - path to a route file, `.npy` or `.csv`, looked up in `tracks_dir` first if without
              folder;
            - name of such a file in `tracks_dir`, or else of one of our own definitions;
            - `reinvent_carpet`, `reinvent_concrete` or `reinvent_wood`: the route of
              `reinvent_base` on other ground;
            - `zoo-0` to `zoo-9999999`: a generated circuit;
            - one of these names followed by `_cw` or `_ccw`: driven clockwise or
              counter-clockwise.
        tracks_dir: Folder with further route files.

    Returns:
        The track, by the name without folder and ending.

    Raises:
        TrackError: There is no track of this name, or its numbers are not a track.
    """
    return _found(world, tracks_dir).track


def describe(world: str, tracks_dir: Path | None = None) -> WorldInfo:
    """Facts about a world; errors as in `load_track`."""
    track, file, definition = _found(world, tracks_dir)
    own = file is None or file.parent == _DEFINITIONS
    width_m = track.locate(track.center).track_width_m
    first, _ = vertices(track.center)
    return WorldInfo(
        name=track.name,
        length_m=track.length_m,
        width_m=Width(float(width_m.mean()), float(width_m.min()), float(width_m.max())),
        direction=("counterclockwise" if track.is_ccw else "clockwise") if track.closed else "open",
        waypoints=len(track.center),
        repeated=np.setdiff1d(np.arange(len(track.center)), first).tolist(),
        spacing_m=track.length_m / (len(first) - 1),
        line_family=look_of(track.name).border_side,
        source="own" if own else str(file),
        difficulty=definition.get("difficulty"),
        about=definition.get("about", ""),
        joined_m=track.joined_m,
    )


def known_worlds(tracks_dir: Path | None = None) -> list[str]:
    """Names that `load_track` accepts, sorted; all may be followed by `_cw` or `_ccw`.

    Generated circuits are left out: there are too many. The folder need not exist.
    """
    return sorted(_files(tracks_dir))


def directed(track: Track, *, clockwise: bool | None = None, reverse: bool = False) -> Track:
    """A track in the requested direction; the one place that decides about directions.

    `clockwise` makes another world; `reverse` is told to reward functions.

    Raises:
        TrackError: The track is not a loop.
    """
    if clockwise is not None:
        if not track.closed:
            raise TrackError(
                f"{track.name} is not a loop, so it has no clockwise direction. Remove "
                "_cw or _ccw from the name, or drive it in reverse."
            )
        if track.is_ccw == clockwise:
            track = replace(track.reversed(), reverse=track.reverse)
    return track.reversed() if reverse else track


class _Found(NamedTuple):
    """`file` is None for a generated circuit."""

    track: Track
    file: Path | None
    definition: dict[str, Any]


def _found(world: str, tracks_dir: Path | None) -> _Found:
    if len(world) > _LONGEST_NAME:
        raise TrackError(
            f"The name of a track has at most {_LONGEST_NAME:,} characters, not {len(world):,} "
            f"('{world[:40]}...'). Use a shorter name or path."
        )
    files = _files(tracks_dir)
    if Path(world).suffix in _ROUTE_FILES:
        file = Path(world)
        # Look it up in the listing: a name such as ../x must not lead out of the folder.
        if tracks_dir is not None and world in _listed(tracks_dir):
            file = tracks_dir / world
        base, _ = split_direction(file.stem)
        known = base in files or zoo.number_of(base) is not None
        if not known or str(file) != file.name or file.exists():
            return _Found(read_route(file), file, {})
        world = file.stem  # people write reinvent_base.npy and mean reinvent_base
    if world in files:
        file = files[world]
        if file.suffix != ".json":
            return _Found(read_route(file), file, {})
        definition: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        if "same_route_as" not in definition:
            return _Found(_build(world, definition), file, definition)
        found = _found(definition["same_route_as"], tracks_dir)
        track = replace(found.track, name=world)
        return found._replace(track=track, definition=found.definition | definition)
    number = zoo.number_of(world)
    if number is not None:
        return _Found(zoo.circuit(number), None, {"about": "A generated circuit."})
    base, clockwise = split_direction(world)
    if clockwise is None or (base not in files and zoo.number_of(base) is None):
        raise TrackError(_unknown(world, tracks_dir))
    found = _found(base, tracks_dir)
    return found._replace(track=replace(directed(found.track, clockwise=clockwise), name=world))


def _files(tracks_dir: Path | None) -> dict[str, Path]:
    folders = [(_DEFINITIONS, ".json")]
    if tracks_dir is not None:
        folders = [*((tracks_dir, suffix) for suffix in _ROUTE_FILES), *folders]
    return {
        name.removesuffix(suffix): folder / name
        for folder, suffix in reversed(folders)
        for name in _listed(folder)
        if name.endswith(suffix)
    }


def _listed(folder: Path) -> set[str]:
    return {file.name for file in folder.glob("[!.]*")}  # macOS leaves a `._` file beside each


def _unknown(world: str, tracks_dir: Path | None) -> str:
    known = known_worlds(tracks_dir)
    by_lower = {name.lower(): name for name in known}
    close = difflib.get_close_matches(world.lower(), by_lower, n=5, cutoff=0.5)
    names = [by_lower[name] for name in close] or known[:5]
    hint = "the closest names are" if close else "examples are"
    where = f"put {world}.npy into {tracks_dir}" if tracks_dir else f"give the path to {world}.npy"
    return (
        f"There is no track '{world}' here; {hint} {', '.join(names)}. Use one of them, or {where}."
    )


def _build(name: str, definition: dict[str, Any]) -> Track:
    """Some waypoints are uneven: racers write their numbers into reward functions."""
    if "ends_m" in definition:
        return _straight(name, definition)
    spline = ClosedSpline(np.array(definition["control_points_m"], dtype=np.float64))
    distance_m = np.linspace(0.0, spline.length_m, definition["waypoints"], endpoint=False)
    for waypoint, shift_m in definition.get("shifted_waypoints_m", {}).items():
        distance_m[int(waypoint)] += shift_m
    center, direction = spline.at(distance_m)
    to_left = np.stack([-direction[:, 1], direction[:, 0]], axis=1) * definition["width_m"] / 2
    center, left, right = (
        np.concatenate([line, line[:1]]) for line in (center, center + to_left, center - to_left)
    )
    track = Track(name, center, left, right, closed=True)
    if track.is_ccw:  # then the inside of the loop lies to the left, as built
        return track
    return Track(name, center, right, left, closed=True)


def _straight(name: str, definition: dict[str, Any]) -> Track:
    first, last = np.array(definition["ends_m"], dtype=np.float64)
    center = np.linspace(first, last, definition["waypoints"])
    along = (last - first) / np.hypot(*(last - first))
    to_left = np.array([-along[1], along[0]]) * definition["width_m"] / 2
    return Track(name, center, center + to_left, center - to_left, closed=False)


_STEPS_PER_PIECE = 200


class ClosedSpline:
    """The smoothest closed curve through points, continuous in curvature.

    Metres, shape (k, 2), k >= 3, no neighbours equal, the first not repeated.
    """

    def __init__(self, points: Floats) -> None:
        self._points = points
        self._chord_m = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
        self._slope = _slopes(points, self._chord_m)
        piece = np.repeat(np.arange(len(points)), _STEPS_PER_PIECE)
        share = np.tile(np.arange(_STEPS_PER_PIECE) / _STEPS_PER_PIECE, len(points))
        xy, _ = self._evaluate(piece, share)
        step_m = np.hypot(*(np.roll(xy, -1, axis=0) - xy).T)
        self._along_m = np.concatenate([[0.0], np.cumsum(step_m)])

    @property
    def length_m(self) -> float:
        return float(self._along_m[-1])

    def at(self, distance_m: Floats) -> tuple[Floats, Floats]:
        """Points at distances from the first one, and unit vectors along the curve."""
        wrapped_m = distance_m % self.length_m
        parameter = np.interp(wrapped_m, self._along_m, np.arange(len(self._along_m)))
        piece, share = np.divmod(parameter / _STEPS_PER_PIECE, 1.0)
        xy, slope = self._evaluate(piece.astype(np.int64) % len(self._points), share)
        return xy, slope / np.hypot(*slope.T)[:, None]

    def _evaluate(self, piece: Ints, share: Floats) -> tuple[Floats, Floats]:
        following = (piece + 1) % len(self._points)
        p, q = self._points[piece], self._points[following]
        h = self._chord_m[piece][:, None]
        u, v = self._slope[piece] * h, self._slope[following] * h
        t = share[:, None]
        bend, twist = 3 * (q - p) - 2 * u - v, 2 * (p - q) + u + v
        return ((twist * t + bend) * t + u) * t + p, ((3 * twist * t + 2 * bend) * t + u) / h


def _slopes(points: Floats, chord_m: Floats) -> Floats:
    """Such that the second derivative is continuous; see `race.bots`."""
    k = len(points)
    here, before, after = np.arange(k), np.arange(k) - 1, (np.arange(k) + 1) % k
    secant = (points[after] - points) / chord_m[:, None]
    a, b = chord_m[before], chord_m
    matrix = np.zeros((k, k))
    np.add.at(matrix, (here, before), b)
    np.add.at(matrix, (here, here), 2 * (a + b))
    np.add.at(matrix, (here, after), a)
    return _solved(matrix, 3 * (b[:, None] * secant[before] + a[:, None] * secant))


def _solved(matrix: Floats, right: Floats) -> Floats:
    """By elimination, so that waypoints are the same on every processor.

    Libraries add in another order on each kind.
    """
    rows = np.concatenate([matrix, right], axis=1)
    for k in range(len(matrix)):
        rows[k] /= rows[k, k]
        factor = rows[:, k : k + 1].copy()
        factor[k] = 0.0
        rows -= factor * rows[k]
    return rows[:, len(matrix) :]
