"""Answers about tasks."""

from collections.abc import Sequence
from typing import Any

from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.web.answers import BadRequest, answers
from drcli.web.hub import Stored
from drcli.web.served_folder import ServedFolder


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """Topic `tasks`, and `GET /api/tasks/N`."""
    folder.hub.add_kind("tasks", lambda _, publish: Stored(publish, folder.tasks.snapshot))

    def one(request: Request) -> Any:
        try:
            number = int(request.path_params["number"])
        except ValueError:
            raise BadRequest("A task has a number.", 404) from None
        return folder.tasks.find(number)

    return [Route("/api/tasks/{number}", answers(one))]
