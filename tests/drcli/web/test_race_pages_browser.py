"""Races in a browser, by keyboard: make one, submit, reorder, and the race night."""

import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import uvicorn

from browser import headless_browser
from drcli.base.clock import wait_until
from drcli.web.console_app import build_app
from drcli.web.served_folder import ServedFolder
from home_races import Home, home_in

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with headless_browser() as started:
        yield started


@pytest.fixture
def home(working_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    found = home_in(working_folder, monkeypatch)
    monkeypatch.setattr("drcli.web.race_reader.open_running_bucket", lambda _: found.bucket)
    monkeypatch.setattr(ServedFolder, "bucket", lambda *_: found.bucket)
    return found


@pytest.fixture
def url(home: Home) -> Iterator[str]:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        config = uvicorn.Config(
            build_app(home.folder, None), ws="websockets-sansio", log_level="warning"
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, args=([bound],), daemon=True)
        thread.start()
        assert wait_until(lambda: server.started, patience_s=30.0)
        yield f"http://127.0.0.1:{bound.getsockname()[1]}"
        server.should_exit = True
        server.force_exit = True
        thread.join(30.0)


@pytest.fixture
def page(chromium: Any) -> Iterator[Any]:
    context = chromium.new_context(viewport={"width": 360, "height": 800})
    context.set_default_timeout(60_000)
    page = context.new_page()
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    yield page
    context.close()
    assert problems == []


def test_a_race_is_made_and_its_queue_reordered_by_keyboard(home, url, page):
    page.goto(f"{url}/#/races")
    page.get_by_role("button", name="Make the first race").press("Enter")
    page.get_by_label("Name", exact=True).fill("Cup")
    page.get_by_label("Laps", exact=True).fill("0")
    page.get_by_text("“Laps” 0 is not from 1 to 100.").wait_for()
    page.get_by_label("Laps", exact=True).fill("2")
    page.get_by_text("Best of 2 laps.").wait_for()
    page.get_by_role("button", name="Make this race").press("Enter")
    page.get_by_role("button", name="Submit a model").press("Enter")
    page.get_by_label("Model", exact=True).select_option("bob")
    page.get_by_label("Racer", exact=True).fill("Bob <b>")
    page.keyboard.press("Enter")
    page.get_by_text("1 run waits").wait_for()
    home.submit("ann")  # a command in another shell
    page.locator(".race-queue li").nth(1).press("Alt+ArrowUp")
    page.locator(".race-queue li:first-child strong", has_text="Ann").wait_for()

    assert page.evaluate("document.activeElement.dataset.key").startswith("item-")
    assert page.evaluate("document.documentElement.scrollWidth") <= 360


def test_a_race_night_shows_who_leads_and_then_who_has_won(home, url, page):
    home.race()
    for name in ("ann", "bob"):
        home.submit(name)
    home.laps = {"ann": [9.0, 8.5], "bob": [7.0, 7.5]}
    page.set_viewport_size({"width": 1920, "height": 1080})
    page.goto(f"{url}/#/night/cup")
    page.get_by_text("Nobody has driven yet.").wait_for()
    home.run()
    page.locator(".night-board li").first.get_by_text("0:07.000").wait_for()
    page.locator(".night-last").get_by_text("Last result").wait_for()
    size = page.evaluate(
        "parseFloat(getComputedStyle(document.querySelector('.night-racer')).fontSize)"
    )
    assert size >= 60.0

    from drcli.races.organise import close_race

    close_race(home.bucket, "cup")
    page.locator(".night-winner-name", has_text="Bob").wait_for()
    page.keyboard.press("ArrowRight")
    page.locator(".night-board li").nth(1).wait_for()
