"""Races in a browser, by keyboard: make one, submit, reorder, and the race night."""

import os
import shutil
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from drcli.base.processes import started_s
from drcli.model import race_keys
from drcli.records.run_record import EvaluationRecord
from home_races import Home
from live_worker import driving


@pytest.fixture
def folder(home: Home) -> Path:
    return home.folder


def test_a_race_is_made_and_its_queue_reordered_by_keyboard(home, served, visit):
    page = visit(f"{served.url}/#/races", width=360).page
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


def test_a_race_night_shows_who_leads_and_then_who_has_won(home, served, visit):
    home.race()
    for name in ("ann", "bob"):
        home.submit(name)
    home.laps = {"ann": [9.0, 8.5], "bob": [7.0, 7.5]}
    page = visit(f"{served.url}/#/night/cup", width=1920).page
    page.set_viewport_size({"width": 1920, "height": 1080})
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


@contextmanager
def driven_live(folder):
    """An evaluation of a submission that shows its car until the block is left."""
    me, name = os.getpid(), "20261129010203"
    prefix = f"{race_keys.folder('cup')}models/x/ann"
    record = EvaluationRecord(
        *(0, name, "bucket", prefix, "reinvent_base", "5.ckpt"),
        *(me, started_s(me), me, time.time()),
    )
    place = folder / "data" / "runs" / "0" / "evaluations" / name
    place.mkdir(parents=True)
    record.write(place)
    with driving(folder, f"evaluation-{name}"):
        yield
    shutil.rmtree(place)


def test_a_race_night_shows_the_car_that_drives(home, served, visit):
    home.race()
    home.submit("ann")
    page = visit(f"{served.url}/#/night/cup", width=1920).page
    page.set_viewport_size({"width": 1920, "height": 1080})
    now = page.get_by_role("region", name="Driven now")

    def watch(_):
        now.get_by_text("Ann").wait_for()
        with driven_live(home.folder):
            camera = page.get_by_role("img", name="What the car of Ann sees")
            camera.and_(page.locator("[data-age-ms]")).wait_for()
            page.get_by_role("img", name="Map of the track with the car of Ann").wait_for()
            now.get_by_text("Lap 1 of 2").wait_for()
            assert now.get_by_label("Split times of Ann").get_by_role("definition").count() >= 2
        now.get_by_text("The laps are driven").wait_for()

    home.before = watch
    home.run()
    page.locator(".night-board li").first.get_by_text("Ann").wait_for()


def test_a_board_of_thirty_racers_is_short_on_a_phone(home, served, visit):
    home.race()
    for k in range(30):
        home.put_model(f"model-with-a-rather-long-name-{k}")
        home.submit(f"model-with-a-rather-long-name-{k}", f"Racer number {k}")
    home.run()
    page = visit(f"{served.url}/#/race/cup", width=390).page
    rows = page.locator(".race-board tbody tr")
    rows.nth(29).wait_for()
    assert max(rows.nth(k).bounding_box()["height"] for k in range(30)) < 65.0
    assert page.evaluate("document.documentElement.scrollHeight") < 4000
    weights = rows.first.locator("td").evaluate_all(
        "cells => cells.map(each => Number(getComputedStyle(each).fontWeight))"
    )
    assert weights.count(400) > len(weights) / 2


def test_wrong_rules_are_marked_and_what_was_typed_is_not_lost(home, served, visit):
    page = visit(f"{served.url}/#/races?new=1").page
    name, laps = (page.get_by_label(each, exact=True) for each in ("Name", "Laps"))
    name.fill("Cup of drafts")
    laps.fill("three")
    page.get_by_text("“Laps” is not a whole number.").wait_for()
    assert laps.get_attribute("aria-invalid") == "true"
    page.get_by_role("button", name="Make this race").click()
    assert page.evaluate(
        "document.activeElement === document.querySelector('[data-key=max_laps] input')"
    )
    page.get_by_role("link", name="Models").click()
    page.get_by_role("heading", name="Models").wait_for()
    page.get_by_role("link", name="Races").click()
    page.get_by_text("not saved is shown again").wait_for()
    assert (name.input_value(), laps.input_value()) == ("Cup of drafts", "three")
    laps.fill("2")
    assert laps.get_attribute("aria-invalid") is None
    page.get_by_role("button", name="Make this race").click()
    page.get_by_role("button", name="Change the rules").click()
    page.get_by_label("Laps", exact=True).fill("4")
    page.reload()
    page.get_by_text("not saved is shown again").wait_for()
    assert page.get_by_label("Laps", exact=True).input_value() == "4"


def test_a_submission_says_how_its_checkpoint_drove_and_what_is_wrong(home, served, visit):
    home.race(max_submissions=1)
    page = visit(f"{served.url}/#/race/cup").page
    for said in ("Ann has submitted checkpoint 5 of ann", "allow 1 for each racer."):
        page.get_by_role("button", name="Submit a model").click()
        page.get_by_role("option", name="the best: 5, not evaluated by its training").wait_for(
            state="attached"
        )
        page.get_by_label("Racer", exact=True).fill("Ann")
        page.get_by_role("button", name="Submit", exact=True).click()
        page.get_by_text(said).wait_for()
    racer = page.get_by_label("Racer", exact=True)
    assert racer.get_attribute("aria-invalid") == "true"
    assert "dr-race" not in page.get_by_role("dialog").inner_text()


def test_an_average_is_told_while_its_racer_still_drives(home, served, visit):
    page = visit(f"{served.url}/#/races").page
    rules = {"ranking": "best-average", "min_laps": 2, "average_laps": 2}
    laps = [{"progress": 100, "resets": 0, "time_s": time_s} for time_s in (9.0, 8.0, 7.0)]
    laps.insert(2, {"progress": 100, "resets": 1, "time_s": 1.0})

    so_far = "given => import('/night_page.js').then(page => page.resultSoFar(...given))"

    assert page.evaluate(so_far, [rules, laps]) == 8.5
    assert page.evaluate(so_far, [rules, laps[2:]]) == float("inf")
    assert page.evaluate(so_far, [{**rules, "ranking": "best-lap"}, laps]) == 7.0
    assert page.evaluate(so_far, [{**rules, "ranking": "total-time"}, laps]) == float("inf")
