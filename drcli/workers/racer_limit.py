"""The fastest line on a track for `dr-tracks`: looked up, or computed and cached."""

from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.private_files import make_folder
from drcli.exchange.track_limit import (
    BEST_KNOWN,
    COMPUTED,
    LIMIT,
    Route,
    TrackLimit,
    computed_limits,
    limit_of,
    route_of,
)
from drcli.tracks.compute_limit import compute_limit, line_points, track_of
from drcli.tracks.limit_store import StoredLimit, fingerprint, read_limits, write_limits

_KINDS = {LIMIT: "limit", BEST_KNOWN: "best known lap", COMPUTED: "computed"}


@dataclass(frozen=True)
class FastestLine:
    """The fastest line of a car on a track.

    Attributes:
        world: The track.
        car: Name of the car's set.
        reverse: Whether it is driven against the direction of the track.
        kind: limit, best known lap, or computed: no car has driven it.
        lap_s: The time that laps are compared with.
        computed_s: Time of the computed flying lap.
        driven_s: Time of the flying lap that the simulated car drove; None without one.
        line: Points x and y in metres, and the speed there in m/s, in driving order.
        text: The time in a sentence.
    """

    world: str
    car: str
    reverse: bool
    kind: str
    lap_s: float
    computed_s: float
    driven_s: float | None
    line: list[tuple[float, float, float]]
    text: str


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
