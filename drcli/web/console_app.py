"""The application of the console: all routes behind the guard."""

import asyncio
import gzip
import hashlib
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from drcli.web import (
    car_routes,
    episode_routes,
    file_routes,
    live_topics,
    model_routes,
    race_routes,
    reward_routes,
    run_topics,
    settings_routes,
    spot_routes,
    start_routes,
    stream_route,
    subprocess_work,
    task_routes,
    track_routes,
)
from drcli.web.hub import Hub
from drcli.web.security import Guard
from drcli.web.served_folder import ServedFolder
from drcli.web.socket_route import SocketRoute
from drcli.web.tasks import Tasks

# Ends connections that stand still; uvicorn waits without an end.


MOST_CONNECTIONS = 256
"""For another, the oldest that has asked for nothing is ended."""

REQUEST_S = 10.0
"""From the moment of the connection."""

STALLED_S = 20.0
"""Without progress of a request or an answer."""

POLL_S = 2.0
WAITING_BYTES = 4 << 20
"""Answers to pings that nobody reads."""

FAREWELL_S = 2.0


class TimedHttp(H11Protocol):
    """Ends waiting."""

    _asked = False
    _written_s: float | None = None
    _read_s = 0.0
    _began_s = 0.0
    _look: asyncio.TimerHandle | None = None

    # uvicorn asks for a narrower transport than asyncio's protocol does.
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Within `MOST_CONNECTIONS`."""
        super().connection_made(transport)
        self._began_s = self._read_s = self.loop.time()
        if len(self.connections) > MOST_CONNECTIONS:
            _idle_one(self.connections, self).transport.abort()
        self._look = self.loop.call_later(POLL_S, self._check)

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_looking()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        self._read_s = self.loop.time()
        if self.timeout_keep_alive_task is not None:  # another request begins
            self._began_s = self._read_s
        super().data_received(data)
        self._asked = self._asked or self.scope is not None

    def pause_writing(self) -> None:
        self._written_s = self.loop.time()
        super().pause_writing()

    def resume_writing(self) -> None:
        self._written_s = None
        super().resume_writing()

    def handle_websocket_upgrade(self, event: Any) -> None:
        self._stop_looking()
        super().handle_websocket_upgrade(event)

    def _stop_looking(self) -> None:
        if self._look is not None:
            self._look.cancel()
            self._look = None

    def _check(self) -> None:
        now = self.loop.time()
        cycle = self.cycle
        waits_for_body = cycle is not None and cycle.more_body and not cycle.response_complete
        between = (
            cycle is None or cycle.response_complete
        ) and self.timeout_keep_alive_task is None
        if (
            (between and now - self._began_s > REQUEST_S)
            or (waits_for_body and now - self._read_s > STALLED_S)
            or (self._written_s is not None and now - self._written_s > STALLED_S)
        ):
            self.transport.abort()
            return
        self._look = self.loop.call_later(POLL_S, self._check)


def _idle_one(connections: Any, newest: TimedHttp) -> TimedHttp:
    idle = [each for each in connections if isinstance(each, TimedHttp) and not each._asked]
    return min(idle, key=lambda each: each._began_s, default=newest)


class TimedWebSocket(WebSocketsSansIOProtocol):
    """Ends waiting."""

    def data_received(self, data: bytes) -> None:
        """Within `WAITING_BYTES`."""
        if self.transport.get_write_buffer_size() > WAITING_BYTES:
            self.transport.abort()
            return
        super().data_received(data)

    def keepalive_timeout(self) -> None:
        super().keepalive_timeout()
        self.loop.call_later(FAREWELL_S, self._cut)

    async def run_asgi(self) -> None:
        try:
            await super().run_asgi()
        finally:
            with suppress(RuntimeError):  # the loop has been closed
                self.loop.call_later(FAREWELL_S, self._cut)

    def _cut(self) -> None:
        if not self.disconnected:
            self.transport.abort()


# The files of the page.


_TYPES = {
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "svg": "image/svg+xml",
    "png": "image/png",
}


def _collect(folder: Traversable, at: str) -> dict[str, Traversable]:
    found: dict[str, Traversable] = {}
    for item in folder.iterdir():
        if item.is_dir():
            found.update(_collect(item, f"{at}{item.name}/"))
        elif item.name.rpartition(".")[2] in _TYPES:
            found[f"{at}{item.name}"] = item
    return found


@cache
def compressed(data: bytes) -> bytes:
    """Half a megabyte for all files together."""
    return gzip.compress(data, mtime=0)


def page_routes() -> list[Route]:
    """Only for files of the package, whatever the path says."""
    known = _collect(files("drcli.web") / "pages", "/")

    async def serve(request: Request) -> Response:
        path = request.url.path
        item = known.get("/index.html" if path == "/" else path)
        if item is None:
            return PlainTextResponse("There is no such page.", 404)
        data = item.read_bytes()
        # The browser asks each time: old and new modules of an update must not be mixed.
        headers = {"cache-control": "no-cache", "vary": "accept-encoding"}
        headers["etag"] = f'"{hashlib.sha256(data).hexdigest()[:32]}"'
        if request.headers.get("if-none-match") == headers["etag"]:
            return Response(status_code=304, headers=headers)
        if "gzip" in request.headers.get("accept-encoding", ""):
            data = compressed(data)
            headers["content-encoding"] = "gzip"
        kind = _TYPES[path.rpartition(".")[2] if path != "/" else "html"]
        return Response(data, media_type=kind, headers=headers)

    return [Route("/{path:path}", serve, methods=["GET"])]


MOST_READING = 32
PARTS: tuple[Callable[[ServedFolder], Sequence[BaseRoute]], ...] = (
    run_topics.machine_routes,
    run_topics.routes,
    model_routes.routes,
    race_routes.routes,
    task_routes.routes,
    stream_route.routes,
    live_topics.routes,
    run_topics.log_routes,
    episode_routes.topics,
    track_routes.routes,
    settings_routes.routes,
    track_routes.track_list_routes,
    file_routes.action_space_routes,
    file_routes.routes,
    reward_routes.routes,
    start_routes.routes,
    spot_routes.routes,
    car_routes.routes,
    episode_routes.routes,
)
"""Each declares its topics with the hub, and returns its routes below /api."""


def build_app(directory: Path, token: str | None, *, here_only: bool = False) -> ASGIApp:
    """`token` and `here_only`: as for `Guard`."""
    hub = Hub()
    tasks = Tasks(hub.publish, directory / "data" / "viewer" / "tasks.json")
    folder = ServedFolder(directory, hub, tasks)
    routes: list[BaseRoute] = [WebSocketRoute("/ws", SocketRoute(hub).serve)]
    for part in PARTS:
        routes += part(folder)
    routes.append(Route("/api/{path:path}", _unknown, methods=["GET", "POST", "PUT", "DELETE"]))
    routes += page_routes()

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()
        # By default there are as few threads as cores: one bucket that is away would take them all.
        loop.set_default_executor(ThreadPoolExecutor(MOST_READING, thread_name_prefix="read"))
        hub.run_in(loop)
        yield
        hub.close()
        await asyncio.to_thread(folder.live.close)
        tasks.closing.set()
        subprocess_work.end_heavy()
        for end in folder.at_end:
            end()
        await asyncio.to_thread(tasks.close)

    return Guard(Starlette(routes=routes, lifespan=lifespan), token, here_only=here_only)


async def _unknown(_: Request) -> Response:
    body = {"error": {"message": "There is no such answer.", "remedy": "", "code": 2}}
    return JSONResponse(body, 404)
