"""How far a lap is from the fastest one of its car on its track."""

import json
import re
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from drcli.base.installation import lazy_imports
from drcli.config import track_names
from drcli.config.run_config import DriveConfig
from drcli.records.trace import STEP_S
from drcli.tracks.limit_store import SHIPPED, LimitKey, StoredLimit, fingerprint, read_limits

with lazy_imports():
    import numpy as np

LIMIT, BEST_KNOWN, COMPUTED = "the limit", "the best known lap", "the computed lap"
"""What a lap is called: computed and driven within 3 %; driven only; computed only."""

WINDOW_STATIONS = 12
FEWEST_WINDOWS, MOST_WINDOWS = 6, 20
"""Parts of a lap among which the places are that cost most time, each at least so long."""

LEAST_LOST_S = 0.05

_OWN_CAR = {
    "car_steering_left": 30.0,
    "car_steering_right": 30.0,
    "car_steering_trim": 0.0,
    "car_max_speed": 4.0,
    "car_battery": 1.0,
}


@dataclass(frozen=True)
class TrackLimit:
    lap_s: float
    name: str

    @classmethod
    def of(cls, stored: StoredLimit) -> "TrackLimit":
        """The computed lap if driven; else the fastest driven."""
        if stored.validated:
            return cls(stored.computed_s, LIMIT)
        if stored.driven_s is not None:
            return cls(stored.driven_s, BEST_KNOWN)
        return cls(stored.computed_s, COMPUTED)

    def __str__(self) -> str:
        """Such as "the limit of this car on this track (5.64 s)"."""
        driven = ", which no car has driven" if self.name == COMPUTED else ""
        return f"{self.name} of this car on this track ({self.lap_s:.2f} s{driven})"


@dataclass(frozen=True)
class LostPlace:
    first_waypoint: int
    last_waypoint: int
    own_s: float
    line_s: float

    @property
    def lost_s(self) -> float:
        return self.own_s - self.line_s

    def __str__(self) -> str:
        """Such as "waypoints 20 to 26: 0.31 s (0.93 s, the line 0.62 s)"."""
        return (
            f"waypoints {self.first_waypoint} to {self.last_waypoint}: {self.lost_s:.2f} s "
            f"({self.own_s:.2f} s, the line {self.line_s:.2f} s)"
        )


class LapRow(NamedTuple):
    progress: float
    waypoint: int


def above_limit(lap_s: float, limit: TrackLimit) -> str:
    """Such as "7.61 s: 35 % above the limit of this car on this track (5.64 s)"."""
    percent = round(100.0 * (lap_s / limit.lap_s - 1.0))
    if lap_s < limit.lap_s:
        return f"{lap_s:.2f} s: faster than {limit}"
    return f"{lap_s:.2f} s: {percent} % above {limit}"


def limit_text(lap_s: float | None, stored: StoredLimit | None) -> str:
    if lap_s is None or stored is None:
        return ""
    return above_limit(lap_s, TrackLimit.of(stored))


def limit_of_race(race: DriveConfig, *, reverse: bool) -> StoredLimit | None:
    if any(getattr(race, name) != usual for name, usual in _OWN_CAR.items()):
        return None
    return limit_of(
        race.world_name, race.tracks_folder, race.directory, reverse=reverse, car=race.sim_car
    )


def limit_of(
    world: str, tracks_folder: Path, directory: Path, *, reverse: bool, car: str
) -> StoredLimit | None:
    """The racer's computed limit, else the shipped one."""
    try:
        route = route_of(world, tracks_folder, directory)
        if route is None:
            return None
        status = route.file.stat()
        print_ = _fingerprint(route.file, status.st_mtime_ns, status.st_size)
    except (OSError, ValueError):
        return None
    key = LimitKey(print_, route.turned != reverse, car)
    for file in (computed_limits(directory), SHIPPED):
        if (found := read_limits(file).get(key)) is not None:
            return found
    return None


def computed_limits(directory: Path) -> Path:
    return directory / "data" / "cache" / "limits.npz"


class Route(NamedTuple):
    file: Path
    turned: bool


def route_of(world: str, tracks_folder: Path, directory: Path) -> Route | None:
    """By name or file; OSError if unreadable, ValueError if it is not a route."""
    if (file := _file_of(world, tracks_folder, directory)) is not None:
        return Route(file, turned=False)
    way = re.search(r"_(c?)cw\Z", Path(world).stem)
    if way is None:
        return None
    plain = Path(world).stem[: way.start()]
    if (file := _file_of(plain, tracks_folder, directory)) is None:
        return None
    return Route(file, turned=_is_ccw(file) != bool(way.group(1)))


def _file_of(world: str, tracks_folder: Path, directory: Path) -> Path | None:
    path = Path(world)
    names = [world] if path.suffix in track_names.ROUTE_FILES else []
    if names and "/" in world:
        return directory / path if (directory / path).is_file() else None
    names += [f"{path.stem if names else world}{end}" for end in track_names.ROUTE_FILES]
    places = [folder / name for folder in (tracks_folder, directory) for name in names]
    own = [place for place in places if place.parent == tracks_folder or place.name == world]
    if (file := next((place for place in own if place.is_file()), None)) is not None:
        return file
    return track_names.definition(path.stem if names[0] == world else world)


def _is_ccw(file: Path) -> bool:
    if file.suffix == ".json":
        points = json.loads(file.read_text("utf-8"))["control_points_m"]
    else:
        rows = (
            np.load(file, allow_pickle=False)
            if file.suffix == ".npy"
            else np.genfromtxt(file, delimiter=",", encoding="utf-8", skip_header=1)
        )
        points = rows[:, :2].tolist()
    following = [*points[1:], points[0]]
    area = sum(x * b - a * y for (x, y), (a, b) in zip(points, following, strict=True))
    return bool(area > 0.0)


@lru_cache(maxsize=32)
def _fingerprint(file: Path, changed: int, size: int) -> str:
    return fingerprint(file)


def lost_places(rows: Sequence[LapRow], start: float, line: StoredLimit) -> list[LostPlace]:
    """The three parts of a lap that cost most time against a line, worst first.

    Without the first part, as a car from rest gathers speed. Rows are 1/15 s apart; `line` runs
    from waypoint 0 in the lap's direction.
    """
    count = len(line.clock_ms)
    windows = min(MOST_WINDOWS, max(FEWEST_WINDOWS, count // WINDOW_STATIONS))
    driven: list[tuple[float, int]] = [(0.0, 0)]
    for number, row in enumerate(rows):
        if row.progress > driven[-1][0]:
            driven.append((row.progress, number))
    found = []
    for window in range(1, windows):
        begin, end = 100.0 * window / windows, 100.0 * (window + 1) / windows
        own_s = (_at(driven, end) - _at(driven, begin)) * STEP_S
        first, last = start + begin / 100.0, start + end / 100.0
        line_s = _line_time_s(line, last) - _line_time_s(line, first)
        if own_s - line_s < LEAST_LOST_S:
            continue
        found.append(
            LostPlace(
                first_waypoint=rows[round(_at(driven, begin))].waypoint,
                last_waypoint=rows[round(_at(driven, end))].waypoint,
                own_s=own_s,
                line_s=line_s,
            )
        )
    return sorted(found, key=lambda place: -place.lost_s)[:3]


def _at(driven: Sequence[tuple[float, int]], progress: float) -> float:
    after = min(bisect_left(driven, (progress, -1)), len(driven) - 1)
    (low, step), (high, later) = driven[max(after - 1, 0)], driven[after]
    share = (progress - low) / (high - low) if high > low else 1.0
    return step + min(share, 1.0) * (later - step)


def _line_time_s(line: StoredLimit, fraction: float) -> float:
    count = len(line.clock_ms)
    lap, place = divmod(fraction * count, count)
    station = min(int(place), count - 1)
    end_ms = line.clock_ms[station + 1] if station + 1 < count else 1000.0 * line.computed_s
    time_ms = line.clock_ms[station] + (place - station) * (end_ms - line.clock_ms[station])
    return lap * line.computed_s + time_ms / 1000.0
