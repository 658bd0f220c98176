"""Races in a browser, by keyboard: make one, submit, reorder, and the race night."""

from pathlib import Path

import pytest

from home_races import Home


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
