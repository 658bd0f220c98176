"""Tracks to choose from, with outlines."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.base.plain_json import plain
from drcli.config.loading import load_settings
from drcli.config.track_names import COMMUNITY
from drcli.tracks.track_list import list_tracks
from drcli.web.answers import answers
from drcli.web.served_folder import ServedFolder

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

OUTLINE_POINTS = 90


def _thinned(border: "NDArray[np.float64]") -> list[list[float]]:
    step = max(1, -(-len(border) // OUTLINE_POINTS))
    kept: list[list[float]] = border[::step].round(2).tolist()
    return kept


def _outline(name: str, folder: Path) -> dict[str, Any] | None:
    import numpy as np

    from drsim.errors import TrackError
    from drsim.track.worlds import load_track

    try:
        track = load_track(name, folder)
    except TrackError:
        return None
    start = track.pose_at(np.zeros(1))[0].round(3).tolist()
    return {"inner": _thinned(track.inner), "outer": _thinned(track.outer), "start": start}


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
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
