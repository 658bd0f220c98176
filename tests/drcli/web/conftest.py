"""The console as pages and scripts meet it: its routes, a served console, and a browser."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from starlette.testclient import TestClient

from browser import headless_browser
from bucket_server import without_server
from drcli.web.console_app import build_app
from drcli.web.model_reader import ModelReader
from drcli.web.served_folder import ServedFolder
from home_races import Home, home_in
from served_console import ServedConsole, served_console

BASE = "http://127.0.0.1:8100"


@pytest.fixture
def folder(working_folder: Path) -> Path:
    """The folder of the console; modules have others in its place."""
    return working_folder


@pytest.fixture
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder without a file, with nothing of this process's own settings."""
    for name in [name for name in os.environ if name.startswith("DR_")]:
        monkeypatch.delenv(name)
    with without_server(tmp_path):
        yield tmp_path


@pytest.fixture
def home(working_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    """A working folder with models for races, on a bucket in memory."""
    found = home_in(working_folder, monkeypatch)
    monkeypatch.setattr("drcli.web.race_reader.open_running_bucket", lambda _: found.bucket)
    for owner in (ServedFolder, ModelReader):
        monkeypatch.setattr(owner, "bucket", lambda *_: found.bucket)
    return found


@pytest.fixture
def client(folder: Path) -> Iterator[TestClient]:
    """Requests of a page of the console; without the header Origin for others."""
    app = build_app(folder, None)
    with TestClient(app, base_url=BASE, headers={"origin": BASE}) as client:
        yield client


@pytest.fixture
def served(folder: Path) -> Iterator[ServedConsole]:
    """The console of the folder, on a port of this machine."""
    with served_console(folder) as console:
        yield console


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """One browser for the tests of a module. Not longer: its library holds the event loop."""
    with headless_browser() as started:
        yield started


class Visit:
    """A page in the browser, and what it did."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.requests: list[str] = []
        self.problems: list[str] = []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("websocket", lambda socket: self.requests.append(socket.url))
        page.on("pageerror", lambda error: self.problems.append(str(error)))
        page.on("console", self._note)

    def _note(self, message: Any) -> None:
        # A server that is away on purpose, or that refuses an input, is no fault of the page.
        expected = ("ERR_CONNECTION", "a status of 409", "a status of 422")
        if message.type == "error" and not any(each in message.text for each in expected):
            self.problems.append(message.text)


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[..., Visit]]:
    """Opens a page; at the end, no error was reported and no request has left its origin."""
    visits: list[tuple[Visit, str]] = []

    def go(url: str, *, theme: str = "light", width: int = 1280, **options: Any) -> Visit:
        context = browser.new_context(
            color_scheme=theme, viewport={"width": width, "height": 900}, **options
        )
        context.set_default_timeout(60_000)
        visited = Visit(context.new_page())
        visits.append((visited, urlsplit(url).netloc))
        visited.page.goto(url)
        return visited

    yield go
    for visited, netloc in visits:
        visited.page.context.close()
        assert visited.problems == []
        assert no_requests_leave(visited.requests, netloc)


def no_requests_leave(requests: list[str], netloc: str) -> bool:
    """Whether every request of a page went to the console."""
    parts = [urlsplit(url) for url in requests]
    return bool(parts) and all(
        part.scheme in ("data", "blob") or part.netloc == netloc for part in parts
    )
