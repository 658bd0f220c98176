"""Every page at three sizes, light and dark, and with the keyboard alone."""

import pytest

from drcli.web import run_topics
from looks import faults, unreached
from played_model import MODEL, played_model
from stored_models import StoredModels

OTHER = "team/model-1"


@pytest.fixture
def folder(home, monkeypatch, make_report):
    """A racer's folder with a training that runs, models, episodes, and a race with laps."""
    stored = StoredModels(home.folder)
    stored.model(OTHER)
    clean = {"off_track_count": 0, "reset_count": 0}
    stored.evaluation(OTHER, lap_ms=(12_345, 61_000), **clean)
    stored.evaluation(OTHER, "20260102030500", lap_ms=(11_000,), **clean)
    played = played_model()
    for info in played.list(""):
        home.bucket.put(info.key, played.get(info.key))
    for path in stored.folder.rglob("*"):
        if path.is_file():
            home.bucket.put(path.relative_to(stored.folder).as_posix(), path.read_bytes())
    home.race()
    for name in ("ann", "bob"):
        home.submit(name)
    home.laps = {"ann": [9.0, 8.5], "bob": [7.0, 7.5]}
    home.run()
    home.submit("cem")
    report = make_report(
        iterations=12, prefix=MODEL, warning="the car zigzags", advice=["Lower `lr`."]
    )
    monkeypatch.setattr(run_topics, "inspect", lambda config, reader: report)
    return home.folder


MODEL_1 = f"/model?prefix={OTHER}"
CASES = {
    "/": "Worker",
    "/new": "The check runs while you type",
    "/models": OTHER,
    "/models?family=1": OTHER,
    MODEL_1: "Verdict and advice",
    f"{MODEL_1}&tab=checkpoints": "best",
    f"{MODEL_1}&tab=evaluations": "11.00 s",
    f"{MODEL_1}&tab=files&other={MODEL}": "Differences from",
    f"{MODEL_1}&tab=notes": "New note",
    "/play": "Play",
    "/races": "Cup",
    "/races?new=1": "Give the race a name",
    "/race/cup": "Cem",
    "/night/cup": "Cem",
    "/spot": "Spot machines",
    "/car": "No car is named",
    "/settings": "Search settings",
    "/nowhere": "There is no such page",
}
DIALOGS = {
    (MODEL_1, "Clone"): "Name of the new model",
    (MODEL_1, "Evaluate"): "Laps",
    (MODEL_1, "Delete"): "to confirm",
    ("/race/cup", "Submit a model"): "The race gets a copy",
    ("/race/cup", "Delete"): "It cannot be undone",
}


@pytest.mark.nightly
@pytest.mark.parametrize("path", CASES)
def test_a_page_fits_and_is_read_and_reached(served, visit, path):
    visited = visit(f"{served.url}/#{path}", width=390)
    page = visited.page
    page.set_default_timeout(15000)
    page.get_by_text(CASES[path]).first.wait_for()

    assert faults(page) == []
    assert unreached(page) == []
    # Without an account and a car, the browser itself reports what was refused.
    visited.problems[:] = [each for each in visited.problems if "a status of" not in each]


@pytest.mark.nightly
@pytest.mark.parametrize(("path", "button"), DIALOGS)
def test_a_dialog_fits_and_gives_the_focus_back(served, visit, path, button):
    page = visit(f"{served.url}/#{path}", width=390).page
    opener = page.get_by_role("button", name=button, exact=True).first
    opener.press("Enter")
    page.get_by_role("dialog").get_by_text(DIALOGS[path, button]).first.wait_for()

    assert faults(page) == []
    assert unreached(page) == []
    page.keyboard.press("Escape")
    page.get_by_role("dialog").wait_for(state="detached")
    assert page.evaluate("document.activeElement.textContent.trim()") == button
