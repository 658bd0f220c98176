"""Answers of the console: reports as JSON, errors with a remedy."""

import dataclasses
import functools
import gzip
import json
from collections.abc import Awaitable, Callable
from typing import Any

import anyio
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from drcli.base.errors import (
    BudgetUsedUp,
    DrError,
    NotAvailable,
    OwnershipLost,
    Problem,
    ProblemsError,
    SettingsError,
    StorageError,
    TrainedElsewhere,
)
from drcli.base.installation import import_error
from drcli.base.json_record import keys_of, plain
from drcli.base.log import get_logger
from drcli.config.editing import FilesChanged

MOST_BYTES = 1 << 20
LONG_BYTES = 2000
MOST_DEPTH = 20
_STATUS: dict[type[DrError], int] = {
    FilesChanged: 409,
    SettingsError: 422,
    StorageError: 503,
    NotAvailable: 501,
    OwnershipLost: 409,
    TrainedElsewhere: 409,
    BudgetUsedUp: 409,
}

_logger = get_logger(__name__)


class BadRequest(Exception):
    """Not from the page."""

    def __init__(self, message: str, status: int = 400) -> None:
        super().__init__(message)
        self.status = status


def report(value: Any, status: int = 200) -> Response:
    """The JSON that the command prints with --json."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return JSONResponse(keys_of(value), status)
    return JSONResponse(plain(value), status)


def error_of(error: Exception) -> dict[str, Any]:
    """An unexpected error is logged."""
    if isinstance(error, DrError):
        found: dict[str, Any] = {
            "message": str(error),
            "remedy": error.remedy,
            "code": error.code,
        }
        if isinstance(error, ProblemsError):
            found["problems"] = [placed(problem) for problem in error.problems]
        return {"error": found}
    if isinstance(error, BadRequest):
        return {"error": {"message": str(error), "remedy": "", "code": 2}}
    if broken := import_error(error):
        return error_of(broken)
    _logger.error("Unexpected error", exc_info=error)
    return {
        "error": {
            "message": f"This did not work because of a fault in the program ({error!r}).",
            "remedy": "Try again. The details are in data/logs/viewer.log.",
            "code": 1,
        },
    }


def placed(problem: Problem) -> dict[str, Any]:
    """With its place in parts, so that the page can lead there."""
    return problem.as_json() | {"file": problem.file, "line": problem.line, "key": problem.key}


def status_of(error: Exception) -> int:
    if isinstance(error, BadRequest):
        return error.status
    found = (status for kind, status in _STATUS.items() if isinstance(error, kind))
    return next(found, 500)


Handler = Callable[[Request], Awaitable[Response]]


def answers(function: Callable[[Request], Any]) -> Handler:
    """A route that reads: runs a function in a thread, and answers with its report.

    That is a dataclass, plain data, or a `Response`.
    """

    @functools.wraps(function)
    async def handle(request: Request) -> Response:
        try:
            value = await anyio.to_thread.run_sync(function, request)
        except Exception as error:
            return JSONResponse(error_of(error), status_of(error))
        return value if isinstance(value, Response) else packed(request, report(value))

    return handle


def packed(request: Request, response: Response) -> Response:
    """Compressed, if it is long and the browser takes that."""
    if len(response.body) > LONG_BYTES and "gzip" in request.headers.get("accept-encoding", ""):
        response.body = gzip.compress(response.body, 5)
        response.headers["content-length"] = str(len(response.body))
        response.headers["content-encoding"] = "gzip"
    return response


def accepts(function: Callable[[Request, dict[str, Any]], Any]) -> Handler:
    """Like `answers`, with a JSON object."""

    @functools.wraps(function)
    async def handle(request: Request) -> Response:
        try:
            body = await json_object(request)
            value = await anyio.to_thread.run_sync(function, request, body)
        except Exception as error:
            return JSONResponse(error_of(error), status_of(error))
        return value if isinstance(value, Response) else packed(request, report(value))

    return handle


async def json_object(request: Request) -> dict[str, Any]:
    """BadRequest if it is too large or too deep."""
    data = b""
    async for chunk in request.stream():
        data += chunk
        if len(data) > MOST_BYTES:
            raise BadRequest(f"The request is larger than {MOST_BYTES >> 20} MB.", 413)
    try:
        value = json.loads(data or b"{}")
    except (ValueError, RecursionError):
        raise BadRequest("The request is not JSON.") from None
    if not isinstance(value, dict) or _is_deeper(value, MOST_DEPTH):
        raise BadRequest("The request is not a JSON object, or it is nested too deeply.")
    if b"\\ud" in data.lower():
        try:
            json.dumps(value, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise BadRequest("The request has half characters, which no file can have.") from None
    return value


def _is_deeper(value: Any, most: int) -> bool:
    if isinstance(value, dict):
        value = list(value.values())
    if not isinstance(value, list):
        return False
    return most == 0 or any(_is_deeper(item, most - 1) for item in value)


def text_of(body: dict[str, Any], key: str, default: str | None = None) -> str:
    """A text; BadRequest if it is none, or missing without a default."""
    value = body.get(key, default)
    if not isinstance(value, str) or "\0" in value:
        raise BadRequest(f"The request needs a text {key}.")
    return value
