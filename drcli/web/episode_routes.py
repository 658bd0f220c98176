"""Answers of the episode player about stored episodes."""

from collections.abc import Callable, Sequence
from typing import Any

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from drcli.playback.packed_answer import facts_of
from drcli.playback.player_handle import PlayerHandle
from drcli.playback.stored_traces import models_with_traces, stored_traces
from drcli.web.answers import BadRequest, answers
from drcli.web.served_folder import ServedFolder

PACKED = "application/octet-stream"
_NUMBER_LIMIT = 10**9


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """The first request starts the player's process."""
    player = PlayerHandle(folder.directory)
    folder.at_end.append(player.close)

    def models(_: Request) -> Any:
        settings = folder.settings()
        listed = folder.bucket(settings).list("")
        return {"own": settings.model_prefix, "models": models_with_traces(listed)}

    def traces(request: Request) -> Any:
        settings = folder.settings()
        bucket = folder.bucket(settings)
        return stored_traces(bucket, settings.model, _text(request, "model"))

    def asked(do: str, *names: str) -> Callable[[Request], bytes]:
        def ask(request: Request) -> bytes:
            numbers = {name: _number(request, name) for name in names}
            return player.ask({"do": do, **_names(request), **numbers})

        return ask

    def as_json(ask: Callable[[Request], bytes]) -> Callable[[Request], Any]:
        return lambda request: facts_of(ask(request))

    def as_packed(ask: Callable[[Request], bytes]) -> Callable[[Request], Response]:
        return lambda request: Response(ask(request), media_type=PACKED)

    steps = ("episode", "first", "count")
    answered = {
        "models": models,
        "traces": traces,
        "open": as_json(asked("open")),
        "lap": as_json(asked("lap", "episode")),
        "steps": as_packed(asked("steps", *steps)),
        "policy": as_json(asked("policy", *steps, "checkpoint")),
        "explained": as_packed(asked("explain", *steps, "checkpoint")),
    }
    return [Route(f"/api/play/{name}", answers(each)) for name, each in answered.items()]


def _names(request: Request) -> dict[str, str]:
    return {name: _text(request, name) for name in ("model", "trace")}


def _text(request: Request, name: str) -> str:
    value = request.query_params.get(name, "")
    if not value or len(value) > 1024:
        raise BadRequest(f"The request needs a {name}.")
    return value


def _number(request: Request, name: str) -> int:
    text = request.query_params.get(name, "")
    if not (text.isascii() and text.isdecimal() and len(text) < 12):
        raise BadRequest(f"The request needs a number {name}.")
    number = int(text)
    if number > _NUMBER_LIMIT:
        raise BadRequest(f"The number {name} is too large.")
    return number
