"""`GET /api/track?world=NAME`: the lines of a track for a map, in metres."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.base.errors import SettingsError
from drcli.web.answers import BadRequest, answers
from drcli.web.served_folder import ServedFolder

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")


def _line(points: NDArray[np.float64]) -> list[list[float]]:
    rounded: list[list[float]] = np.round(points, 3).tolist()
    return rounded


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """`GET /api/track`."""

    def show(request: Request) -> Any:
        from drsim.errors import TrackError
        from drsim.track.worlds import load_track

        world = request.query_params.get("world", "")
        if _NAME.fullmatch(world) is None:
            raise BadRequest(f"{world[:80]!r} is no name of a track.")
        try:
            track = load_track(world, folder.settings().tracks_folder)
        except TrackError as error:
            raise SettingsError(
                str(error),
                remedy="`dr-tracks` lists the tracks; `dr-tracks fetch NAME` brings one.",
            ) from error
        return {
            "name": track.name,
            "closed": track.closed,
            "length_m": track.length_m,
            "center": _line(track.center),
            "inner": _line(track.inner),
            "outer": _line(track.outer),
        }

    return [Route("/api/track", answers(show))]
