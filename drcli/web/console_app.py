"""The application of the console: all routes behind the guard."""

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ASGIApp

from drcli.web import (
    action_space_routes,
    apart,
    episode_routes,
    episode_topics,
    hyperparameter_routes,
    live_topics,
    log_topic,
    machine_topic,
    model_routes,
    race_routes,
    reward_routes,
    run_topics,
    settings_routes,
    start_routes,
    stream_route,
    task_routes,
    track_list_routes,
    track_routes,
)
from drcli.web.hub import Hub
from drcli.web.page_files import page_routes
from drcli.web.security import Guard
from drcli.web.served_folder import ServedFolder
from drcli.web.socket_route import SocketRoute
from drcli.web.tasks import Tasks

MOST_READING = 32
PARTS: tuple[Callable[[ServedFolder], Sequence[BaseRoute]], ...] = (
    machine_topic.routes,
    run_topics.routes,
    model_routes.routes,
    race_routes.routes,
    task_routes.routes,
    stream_route.routes,
    live_topics.routes,
    log_topic.routes,
    episode_topics.routes,
    track_routes.routes,
    settings_routes.routes,
    track_list_routes.routes,
    action_space_routes.routes,
    hyperparameter_routes.routes,
    reward_routes.routes,
    start_routes.routes,
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
        apart.end_heavy()
        for end in folder.at_end:
            end()
        await asyncio.to_thread(tasks.close)

    return Guard(Starlette(routes=routes, lifespan=lifespan), token, here_only=here_only)


async def _unknown(_: Request) -> Response:
    body = {"error": {"message": "There is no such answer.", "remedy": "", "code": 2}}
    return JSONResponse(body, 404)
