"""A racer who never types a command but the first: everything from an empty folder on in a page."""

import csv
import json
import socket
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from browser import headless_browser

PATIENCE_MS = 120_000.0
"""For a training, an evaluation or a film of a busy machine."""


SOME_OF_IT = """film => film.play().then(() => new Promise((played) =>
    film.addEventListener("timeupdate",
        () => film.currentTime > 0.2 && played(film.currentTime))))"""
"""Plays a film, and returns how far it came."""


@pytest.fixture
def page() -> Iterator[Any]:
    """A page of a browser; at its end, no script has failed and no request has left the machine."""
    problems: list[str] = []
    places: set[str] = set()
    with headless_browser() as browser:
        context = browser.new_context(viewport={"width": 1280, "height": 900})
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("request", lambda request: places.add(urlsplit(request.url).hostname or ""))
        yield page
        context.close()
    assert problems == []
    assert places == {"127.0.0.1"}


def free_port() -> int:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        port: int = bound.getsockname()[1]
        return port


def opened(space: Any, page: Any, path: str = "") -> None:
    """Start the console of a folder with its command, and open a page of it."""
    started = space.run("start-viewer", "-p", str(free_port()), "--json")
    assert started.returncode == 0, started.stderr
    page.goto(json.loads(started.stdout.splitlines()[-1])["url"] + path)


def plays(film: Any) -> bool:
    """Whether a film plays."""
    return bool(film.evaluate(SOME_OF_IT) > 0.2)


def saved(page: Any, button: Any, folder: Path) -> Path:
    """The file that a button gives."""
    with page.expect_download() as downloading:
        button.click()
    path = folder / downloading.value.suggested_filename
    downloading.value.save_as(path)
    return path


def test_from_an_empty_folder_to_an_archive_for_the_car(empty_workspace, page, tmp_path_factory):
    opened(empty_workspace, page)

    page.get_by_role("link", name="New training").first.click()
    page.get_by_label("Name of the first model").fill("first")
    page.get_by_label("Begin with").select_option(value="model:fast")
    page.get_by_role("button", name="Create the working folder").click()
    page.locator("#step-model").wait_for()

    page.get_by_role("link", name="Models").first.click()
    page.get_by_role("link", name="first").click()
    page.get_by_role("button", name="Clone").click()
    page.get_by_label("Name of the new model").fill("second")
    page.get_by_role("dialog").get_by_role("button", name="Clone").click()
    page.locator("#step-start").get_by_text("It begins with the weights of first.").wait_for()
    page.get_by_role("button", name="Start the training").click()

    run = page.get_by_role("region", name="State of the run")
    run.get_by_text("The training of second on reinvent_base runs.").wait_for()
    run.get_by_text("completed a clean lap").wait_for()
    page.locator("article[data-worker=sim-0]").get_by_text("reinvent_base").first.wait_for()
    page.get_by_role("button", name="Stop the training").click()
    run.get_by_text("The training of second on reinvent_base was stopped.").wait_for()
    assert empty_workspace.run("status").returncode == 0

    page.get_by_role("link", name="Open the model").click()
    page.get_by_role("button", name="Evaluate").click()
    page.get_by_role("dialog").get_by_label("Laps").fill("1")
    page.get_by_label("Make videos of it").check()
    page.get_by_role("dialog").get_by_role("button", name="Evaluate").click()
    page.get_by_text("Clean lap", exact=True).first.wait_for()
    film = page.locator("video")
    film.wait_for()
    assert plays(film)

    page.get_by_role("button", name="Download", exact=True).click()
    archive = saved(
        page,
        page.get_by_role("dialog").get_by_role("button", name="Download"),
        tmp_path_factory.mktemp("downloads"),
    )
    with tarfile.open(archive) as packed:
        assert {"model_metadata.json", "agent/model.pb"} <= set(packed.getnames())


@pytest.mark.nightly
def test_a_race_is_driven_from_the_page_and_taken_home(workspace, page, tmp_path):
    workspace.write_run_env(DR_WORLD_NAME="bean", DR_EVAL_MAX_RESETS=100)
    workspace.put_ready_made("safe", "fast")
    opened(workspace, page, "#/races")

    page.get_by_role("button", name="Make the first race").click()
    page.get_by_label("Name", exact=True).fill("Friday Cup")
    page.get_by_label("Laps", exact=True).fill("1")
    page.get_by_role("button", name="Make this race").click()
    for racer, model in (("Ann", "safe"), ("Bob", "fast")):
        page.get_by_role("button", name="Submit a model").click()
        page.get_by_label("Model", exact=True).select_option(model)
        page.get_by_label("Racer", exact=True).fill(racer)
        page.get_by_role("button", name="Submit", exact=True).click()
        page.get_by_text(f"{racer}").first.wait_for()
    page.get_by_role("button", name="Drive the queue").click()
    page.get_by_role("dialog").get_by_role("button").last.click()
    board = page.get_by_role("region", name="Leaderboard")
    board.locator("tbody tr").nth(1).wait_for()
    page.get_by_role("button", name="Close for submissions").click()
    page.get_by_role("dialog").get_by_role("button").last.click()
    page.get_by_text("Winner: Bob.").wait_for()

    assert "Bob" in board.locator("tbody tr").first.inner_text()
    board.get_by_role("button", name="Watch").first.click()
    assert plays(page.locator("video"))
    page.keyboard.press("Escape")
    with saved(page, page.get_by_role("button", name="Save as CSV"), tmp_path).open() as table:
        assert [row["racer"] for row in csv.DictReader(table)] == ["Bob", "Ann"]
