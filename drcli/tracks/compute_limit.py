"""Computes a car's fastest lap, and lets the simulated car drive it."""

from pathlib import Path

import numpy as np

from drcli.base.errors import NotAvailable, SettingsError
from drcli.tracks.limit_store import SOLVER_VERSION, WITHIN, StoredLimit
from drsim.car.car_sets import CAR_SETS
from drsim.errors import TrackError
from drsim.limit.fastest_line import NoLine, SolverMissing, fastest_line
from drsim.limit.grip import GRIPS
from drsim.limit.predictive_driver import drive_line
from drsim.limit.stations import points_of, stations_of
from drsim.track.track import Track
from drsim.track.worlds import load_track

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
