"""`GET /api/track?world=NAME`: the lines of a track for a map, in metres."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.base.errors import SettingsError
from drcli.base.installation import lazy_imports
from drcli.base.json_record import plain
from drcli.config.loading import load_settings
from drcli.config.track_names import COMMUNITY
from drcli.tracks.track_list import list_tracks
from drcli.web.answers import BadRequest, answers
from drcli.web.served_folder import ServedFolder

with lazy_imports():
    from drcli.drive import racer_limit
    from drcli.tracks import outline
    from drsim import errors as drsim_errors
    from drsim.track import worlds

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """`GET /api/track`, and `/api/track/limit` for the fastest line that is known of the car."""

    def show(request: Request) -> Any:
        world = request.query_params.get("world", "")
        if _NAME.fullmatch(world) is None:
            raise BadRequest(f"{world[:80]!r} is not a name of a track.")
        try:
            track = worlds.load_track(world, folder.settings().tracks_folder)
        except drsim_errors.TrackError as error:
            raise SettingsError(
                str(error),
                remedy="`dr-tracks list` shows those that there are.",
            ) from error
        return outline.outline(track)

    def limit(request: Request) -> Any:
        settings, asked = folder.settings(), request.query_params
        world = asked.get("world", "")
        if _NAME.fullmatch(world) is None:
            raise BadRequest(f"{world[:80]!r} is not a name of a track.")
        return racer_limit.fastest_line_of(
            racer_limit.Asked(
                world,
                settings.tracks_folder,
                folder.directory,
                asked.get("reverse") == "true",
                settings.race.sim_car,
            )
        )

    return [Route("/api/track", answers(show)), Route("/api/track/limit", answers(limit))]


# Tracks to choose from, with outlines.


OUTLINE_POINTS = 90
_ORDERS = [
    *(("name", "Name"), ("length_m", "Length")),
    *(("width_m", "Width"), ("direction", "Direction")),
]


def _path(border: "NDArray[np.float64]") -> str:
    step = max(1, -(-len(border) // OUTLINE_POINTS))
    return "M " + " L ".join(f"{x:.2f} {-y:.2f}" for x, y in border[::step])


def _outline(name: str, folder: Path) -> dict[str, Any] | None:
    """Paths of a picture whose unit is a metre: the road, its borders, and where laps begin."""
    try:
        track = worlds.load_track(name, folder)
    except drsim_errors.TrackError:
        return None
    (x, y), points = track.pose_at(np.zeros(1))[0][:2], np.vstack([track.inner, track.outer])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.06 * float((high - low).max())
    inner, outer = _path(track.inner), _path(track.outer)
    if track.closed:
        edges = [f"{inner} Z", f"{outer} Z"]
        road = " ".join(edges)
    else:
        edges = [inner, outer]
        road = f"{outer} L {_path(track.inner[::-1]).removeprefix('M ')} Z"
    wide, tall = high - low + 2 * margin
    return {
        "box": f"{low[0] - margin:.2f} {-high[1] - margin:.2f} {wide:.2f} {tall:.2f}",
        "road": road,
        "edges": edges,
        "start": [round(float(x), 3), round(float(-y), 3)],
        "margin": round(margin, 3),
    }


def track_list_routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """`GET /api/track-list`."""
    outlines: dict[tuple[str, str, float], dict[str, Any] | None] = {}

    def show(_: Request) -> Any:
        settings = load_settings(folder.directory)
        memory = folder.directory / "data" / "cache" / "tracks.json"
        found = list_tracks(settings.tracks_folder, memory)
        rows, used = [], set()
        for track in found.tracks:
            changed_s = 0.0
            if track.source != "own" and Path(track.source).exists():
                changed_s = Path(track.source).stat().st_mtime
            key = (track.name, track.source, changed_s)
            used.add(key)
            if key not in outlines:
                outlines[key] = _outline(track.name, settings.tracks_folder)
            size = f"{track.length_m:.1f} m long, {track.width_m:.2f} m wide"
            facts = ", ".join(filter(None, (size, track.direction, track.difficulty)))
            rows.append(plain(track) | {"outline": outlines[key], "facts": facts})
        for key in outlines.keys() - used:
            del outlines[key]
        names = {track.name for track in found.tracks}
        return {
            "tracks": rows,
            "unreadable": found.unreadable,
            "folder": found.folder,
            "orders": _ORDERS,
            "community": sorted(COMMUNITY - names),
        }

    return [Route("/api/track-list", answers(show))]
