"""The fastest line on a track for `dr-tracks`: looked up, or computed and cached."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from drcli.base.errors import NotAvailable, SettingsError
from drcli.base.files import make_folder
from drcli.base.report import View
from drcli.config.track_names import ZOO
from drcli.tracks.limit_store import (
    SOLVER_VERSION,
    WITHIN,
    StoredLimit,
    fingerprint,
    read_limits,
    write_limits,
)
from drcli.tracks.track_limit import (
    BEST_KNOWN,
    COMPUTED,
    LIMIT,
    Route,
    TrackLimit,
    computed_limits,
    limit_of,
    route_of,
)
from drsim.car.car_parameters import CAR_SETS
from drsim.errors import TrackError
from drsim.limit.fastest_line import (
    GRIPS,
    NoLine,
    SolverMissing,
    fastest_line,
    points_of,
    stations_of,
)
from drsim.limit.predictive_driver import drive_line
from drsim.track.track import Track
from drsim.track.worlds import load_track

# Computes a car's fastest lap, and lets the simulated car drive it.


REMEDY = "Install it: `pip install 'drcli[limit]'`."


def compute_limit(
    file: Path, route: str, *, reverse: bool, car: str, seeds: tuple[int, ...] = (1, 2)
) -> StoredLimit:
    """The limit of a car on a route file or one of our definitions.

    `reverse` is against the rows; more `seeds` drive if earlier ones were too slow.

    Raises:
        NotAvailable: The solver is not installed.
        SettingsError: No track, or no lap found.
    """
    try:
        track = track_of(file, reverse=reverse)
        line = fastest_line(track, GRIPS[car])
    except SolverMissing as error:
        raise NotAvailable(
            f"Computing the fastest lap needs casadi ({error}).", remedy=REMEDY
        ) from None
    except (TrackError, NoLine) as error:
        raise SettingsError(
            f"The fastest lap on {file} cannot be computed: {error}.",
            remedy="Name a track that is a loop; `dr-tracks show` draws it.",
        ) from None
    laps = []
    for seed in seeds:
        lap = drive_line(track, line, CAR_SETS[car].parameters, seed)
        if lap.flying_s is not None:
            laps.append((lap.flying_s, lap.standing_s, seed))
            if lap.flying_s <= WITHIN * line.lap_s:
                break
    driven_s, standing_s, seed = min(laps, default=(None, None, 0))
    stations = stations_of(track, line)
    return StoredLimit(
        route=route,
        reverse=reverse,
        car=car,
        world=file.stem,
        computed_s=round(line.lap_s, 3),
        driven_s=None if driven_s is None else round(driven_s, 3),
        standing_s=None if standing_s is None else round(standing_s, 3),
        seed=seed,
        version=SOLVER_VERSION,
        length_m=round(track.length_m, 3),
        offset_mm=tuple(np.rint(1000 * stations.offset_m).astype(int).tolist()),
        speed_mmps=tuple((10 * np.rint(100 * stations.speed_mps)).astype(int).tolist()),
        clock_ms=tuple(np.rint(1000 * stations.clock_s).astype(int).tolist()),
    )


def track_of(file: Path, *, reverse: bool) -> Track:
    track = load_track(file.stem if file.suffix == ".json" else str(file))
    return track.reversed() if reverse else track


def line_points(track: Track, limit: StoredLimit) -> list[tuple[float, float, float]]:
    """Metres and m/s; `track` in the limit's direction."""
    xy = points_of(track, np.array(limit.offset_mm) / 1000).round(3).tolist()
    return [(x, y, speed / 1000) for (x, y), speed in zip(xy, limit.speed_mmps, strict=True)]


_KINDS = {LIMIT: "limit", BEST_KNOWN: "best known lap", COMPUTED: "computed"}


@dataclass(frozen=True)
class FastestLine:
    """The fastest line of a car on a track."""

    world: Annotated[str, "The track."]
    car: Annotated[str, "Name of the car's set."]
    reverse: Annotated[bool, "Whether it is driven against the direction of the track."]
    kind: Annotated[str, "limit, best known lap, or computed: no car has driven it."]
    lap_s: Annotated[float, "The time that laps are compared with."]
    computed_s: Annotated[float, "Time of the computed flying lap."]
    driven_s: Annotated[
        float | None, "Time of the flying lap that the simulated car drove; None without one."
    ]
    line: Annotated[
        list[tuple[float, float, float]],
        "Points x and y in metres, and the speed there in m/s, in driving order.",
    ]
    text: Annotated[str, "The time in a sentence."]

    def view(self, *, points: bool) -> View:
        if not points:
            return [self.text]
        rows = (f"    ({x:.3f}, {y:.3f}, {speed:.2f})," for x, y, speed in self.line)
        return [f"# {self.text}", "FASTEST_LINE = [", *rows, "]"]


@dataclass(frozen=True)
class Asked:
    world: str
    tracks_folder: Path
    directory: Path
    reverse: bool
    car: str


def fastest_line_of(asked: Asked) -> FastestLine:
    """SettingsError if no line is known, or there is no such track."""
    _route(asked)
    stored = _known(asked)
    if stored is None:
        way = " --reverse" if asked.reverse else ""
        raise SettingsError(
            f"No fastest line of the car {asked.car} on {asked.world} is known.",
            remedy=f"Compute it: `dr-tracks limit {asked.world}{way} --car {asked.car}`.",
        )
    return _told(asked, stored)


def computed_line_of(asked: Asked) -> FastestLine:
    """The known line, or one that is computed, driven, and kept.

    Raises:
        NotAvailable: The solver is not installed.
        SettingsError: There is no such track, or no line on it.
    """
    stored = _known(asked)
    if stored is None:
        route = _route(asked)
        reverse = route.turned != asked.reverse
        stored = compute_limit(route.file, fingerprint(route.file), reverse=reverse, car=asked.car)
        cache = computed_limits(asked.directory)
        make_folder(cache.parent)
        write_limits(cache, {**read_limits(cache), stored.key: stored}.values())
    return _told(asked, stored)


def _known(asked: Asked) -> StoredLimit | None:
    return limit_of(
        asked.world,
        asked.tracks_folder,
        asked.directory,
        reverse=asked.reverse,
        car=asked.car,
    )


def _route(asked: Asked) -> Route:
    try:
        route = route_of(asked.world, asked.tracks_folder, asked.directory)
    except (OSError, ValueError) as error:
        raise SettingsError(
            f"{asked.world} cannot be read: {error}.", remedy="Correct the route file."
        ) from None
    if route is None and ZOO.match(asked.world):
        raise SettingsError(
            f"The fastest line on {asked.world} is not known: only that of a route file is.",
            remedy="Draw a circuit with `dr-tracks generate NAME`, and name that.",
        )
    if route is None:
        raise SettingsError(
            f"There is no track {asked.world} here.", remedy="`dr-tracks list` shows all."
        )
    return route


def _told(asked: Asked, stored: StoredLimit) -> FastestLine:
    limit, route = TrackLimit.of(stored), _route(asked)
    track = track_of(route.file, reverse=route.turned != asked.reverse)
    way = " in reverse" if asked.reverse else ""
    driven = (
        "no car has driven it"
        if stored.driven_s is None
        else f"the simulated car drove {stored.driven_s:.2f} s"
    )
    return FastestLine(
        world=asked.world,
        car=stored.car,
        reverse=asked.reverse,
        kind=_KINDS[limit.name],
        lap_s=limit.lap_s,
        computed_s=stored.computed_s,
        driven_s=stored.driven_s,
        line=line_points(track, stored),
        text=(
            f"{limit.name[:1].upper()}{limit.name[1:]} of the car {stored.car} on {asked.world}"
            f"{way}: {limit.lap_s:.2f} s (computed {stored.computed_s:.2f} s; {driven})."
        ),
    )
