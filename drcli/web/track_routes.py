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


def _thinned(border: "NDArray[np.float64]") -> list[list[float]]:
    step = max(1, -(-len(border) // OUTLINE_POINTS))
    kept: list[list[float]] = border[::step].round(2).tolist()
    return kept


def _outline(name: str, folder: Path) -> dict[str, Any] | None:
    try:
        track = worlds.load_track(name, folder)
    except drsim_errors.TrackError:
        return None
    start = track.pose_at(np.zeros(1))[0].round(3).tolist()
    return {"inner": _thinned(track.inner), "outer": _thinned(track.outer), "start": start}


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
            rows.append(plain(track) | {"outline": outlines[key]})
        for key in outlines.keys() - used:
            del outlines[key]
        names = {track.name for track in found.tracks}
        return {
            "tracks": rows,
            "unreadable": found.unreadable,
            "folder": found.folder,
            "community": sorted(COMMUNITY - names),
        }

    return [Route("/api/track-list", answers(show))]
