"""Answers of the console: reports as JSON, errors with a remedy."""

import dataclasses
import functools
import gzip
import json
import re
from collections.abc import Awaitable, Callable, Collection
from typing import Annotated, Any, ClassVar, Self, TypeVar

import anyio
from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from drcli.base.errors import (
    BadValue,
    BudgetUsedUp,
    DrError,
    NotAvailable,
    OwnershipLost,
    Problem,
    ProblemsError,
    SettingsError,
    StorageError,
    TrainedElsewhere,
    few,
    one_of,
    shown,
)
from drcli.base.installation import import_error
from drcli.base.json_record import keys_of, plain
from drcli.base.log import get_logger
from drcli.config.editing import FilesChanged
from drcli.model.files.data_file import as_written, dotted
from drcli.web.page_words import for_page

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

    def __init__(self, message: str, status: int = 400, remedy: str = "", key: str = "") -> None:
        super().__init__(message)
        self.status, self.remedy, self.key = status, remedy, key


def report(value: Any, status: int = 200) -> Response:
    """The JSON that the command prints with --json."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return JSONResponse(for_page(keys_of(value)), status)
    return JSONResponse(for_page(plain(value)), status)


def error_of(error: Exception) -> Any:
    """An unexpected error is logged."""
    if isinstance(error, DrError):
        found = {"message": str(error), "remedy": error.remedy, "code": error.code}
        if isinstance(error, ProblemsError):
            said = [placed(problem) for problem in error.problems]
            wrong = (each for each in said if each["severity"] == "error")
            found["message"] = "\n".join(few(_with_place(each) for each in wrong))
            found["problems"] = said
        return for_page({"error": found})
    if isinstance(error, BadRequest):
        found = {"message": str(error), "remedy": error.remedy, "code": 2, "key": error.key}
        return {"error": found}
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


def placed(problem: Problem) -> Any:
    """With its place in parts, so that the page can lead there: to a setting by its name."""
    said = problem.as_json() | {"file": problem.file, "line": problem.line, "key": problem.key}
    if problem.key and problem.file.endswith(".env"):
        said["where"] = ""
    return for_page(said)


def _with_place(problem: dict[str, Any]) -> str:
    message = " ".join(problem["message"].split())
    return f"{problem['where']}: {message}" if problem["where"] else message


def status_of(error: Exception) -> int:
    if isinstance(error, BadRequest):
        return error.status
    found = (status for kind, status in _STATUS.items() if isinstance(error, kind))
    return next(found, 500)


T = TypeVar("T", bound=Collection[str])
Handler = Callable[[Request], Awaitable[Response]]


def _handler(
    function: Callable[..., Any], body: Callable[[Request], Awaitable[tuple[Any, ...]]]
) -> Handler:
    @functools.wraps(function)
    async def handle(request: Request) -> Response:
        try:
            given = await body(request)
            value = await anyio.to_thread.run_sync(function, request, *given)
        except Exception as error:
            return JSONResponse(error_of(error), status_of(error))
        return value if isinstance(value, Response) else packed(request, report(value))

    return handle


def answers(function: Callable[[Request], Any]) -> Handler:
    """A route that reads: runs a function in a thread, and answers with its report.

    That is a dataclass, plain data, or a `Response`.
    """

    async def nothing(_: Request) -> tuple[()]:
        return ()

    return _handler(function, nothing)


def packed(request: Request, response: Response) -> Response:
    """Compressed, if it is long and the browser takes that."""
    if len(response.body) > LONG_BYTES and "gzip" in request.headers.get("accept-encoding", ""):
        response.body = gzip.compress(response.body, 5)
        response.headers["content-length"] = str(len(response.body))
        response.headers["content-encoding"] = "gzip"
    return response


def _no_null(text: str) -> str:
    if "\0" in text:
        raise BadValue("has a character that no text may have", "")
    return text


Text = Annotated[str, AfterValidator(_no_null)]


def known(names: Collection[str]) -> AfterValidator:
    """For keys, or for a list."""

    def check(values: T) -> T:
        for name in values:
            if name not in names:
                raise BadValue(
                    f"has {shown(name)}, which is not one of them", one_of(sorted(names), name)
                )
        return values

    return AfterValidator(check)


class Body(BaseModel):
    """A JSON object that a page sends. Keys that are not declared are ignored."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)
    STATUS: ClassVar[int] = 400
    """Of the answer to a wrong value: 422 where people type the values."""

    @classmethod
    def read(cls, values: dict[str, Any]) -> Self:
        """Raises BadRequest, which names the key and its value."""
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]
        key = dotted(fault["loc"])
        remedy = "Correct it, or load the page again."
        if fault["type"] == "missing":
            raise BadRequest(f"The request needs {key}.", cls.STATUS, remedy)
        reason = re.sub(r"^\w+ should", "should", fault["msg"])
        if fault["type"] == "value_error":
            bad = fault["ctx"]["error"]
            reason, remedy = bad.reason, bad.remedy or remedy
        message = f"{key}={as_written(fault['input'])} {reason}."
        raise BadRequest(message, cls.STATUS, remedy, key)


def accepts(function: Callable[[Request, Any], Any], kind: type[Body] | None = None) -> Handler:
    """Like `answers`, with a body of a `kind`: that of the parameter `body`."""
    model: type[Body] = kind or function.__annotations__["body"]

    async def body(request: Request) -> tuple[Body]:
        return (model.read(await json_object(request)),)

    return _handler(function, body)


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
