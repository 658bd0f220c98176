"""The episode player in a browser: an episode is chosen, played by keyboard, and compared."""

from urllib.parse import urlencode

import pytest

from drcli.bucket.connect import FolderBucket
from drcli.web.served_folder import ServedFolder
from looks import faults, unreached
from played_model import EVALUATION, GONE, MODEL, working_folder
from served_console import served_console


@pytest.fixture(scope="module")
def console(tmp_path_factory):
    """A console with the real player; its bucket needs no server."""
    home = working_folder(tmp_path_factory.mktemp("racer"))
    bucket = FolderBucket(home / "data" / "s3" / "bucket")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ServedFolder, "bucket", lambda *_: bucket)
        with served_console(home) as served:
            yield served


def address(console, **query):
    return f"{console.url}/#/play?{urlencode(query)}"


def test_an_episode_is_chosen_played_and_stepped_through_by_keyboard(console, visit):
    page = visit(f"{console.url}/#/play", width=360).page
    link = page.get_by_role("link", name="Play episode 1")
    link.wait_for()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.set_viewport_size({"width": 1280, "height": 900})
    link.press("Enter")

    position = page.locator(".position")
    position.get_by_text("step 1 of 40").wait_for()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowRight")
    position.get_by_text("step 17 of 40").wait_for()
    page.keyboard.press("End")
    position.get_by_text("step 40 of 40").wait_for()
    page.keyboard.press("Home")
    page.keyboard.press(" ")
    page.get_by_role("button", name="Pause").wait_for()
    position.get_by_text("step 40 of 40").wait_for()
    page.get_by_role("button", name="Play").wait_for()
    page.locator(".bars li").first.wait_for()
    page.get_by_text("Camera, drawn again from the recorded pose.").wait_for()
    page.keyboard.press("e")
    page.get_by_text("Camera with the pixels that move the action").wait_for()

    assert page.locator("dd[data-name=speed]").text_content() == "2"
    assert page.locator(".used dt").all_text_contents() == ["progress", "speed"]
    painted = "c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some(v => v > 9)"
    assert page.locator(".camera img").evaluate("picture => picture.naturalWidth") == 160
    assert page.locator(".track-map canvas").evaluate(painted)


def test_two_laps_fit_side_by_side(console, visit):
    other = {"other_model": MODEL, "other_trace": GONE, "other_episode": 0}
    page = visit(address(console, model=MODEL, trace=EVALUATION, episode=1, **other)).page

    page.get_by_text("Checkpoint 2, which drove, is no longer there").wait_for()
    page.locator(".player-controls select").nth(1).select_option("progress")
    page.locator("h1").click()
    page.keyboard.press("End")

    assert page.locator(".episode-pane").count() == 2
    for theme, width in (("light", 360), ("dark", 800), ("light", 1920)):
        page.emulate_media(color_scheme=theme)
        page.set_viewport_size({"width": width, "height": 900})
        # The page hears of it a moment later.
        page.locator(f"html[data-theme={theme}]").wait_for(state="attached")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_choices_are_in_the_address_and_pictures_say_what_they_show(console, visit):
    other = {"other_model": MODEL, "other_trace": EVALUATION, "other_episode": 0}
    page = visit(address(console, model=MODEL, trace=EVALUATION, episode=1, **other)).page

    page.get_by_role("img", name="Speed driven: from").wait_for()
    page.get_by_label("Path shows").select_option("action")
    page.get_by_role("img", name="Number of the action: from").wait_for()
    page.get_by_label("Align by").select_option("progress")
    page.reload()
    page.get_by_role("img", name="Number of the action: from").wait_for()
    assert page.get_by_label("Align by").input_value() == "progress"
    page.get_by_role("link", name="Remove the second lap").click()
    page.locator(".episode-pane").nth(1).wait_for(state="detached")
    page.get_by_role("img", name="Number of the action: from").wait_for()


def test_the_time_that_a_lap_gains_is_told_and_sought(console, visit):
    episode = {"other_model": MODEL, "other_trace": EVALUATION}
    query = {"model": MODEL, "trace": EVALUATION, "episode": 0}
    page = visit(address(console, **query, other_episode=1, **episode)).page

    gained = page.locator("figure", has_text="Time that the second lap gains")
    gained.get_by_text("the second lap is").wait_for()
    before = page.locator(".position").text_content()
    gained.locator(".u-over").click()
    page.wait_for_function(
        "old => document.querySelector('.position').textContent !== old", arg=before
    )
    told = gained.locator(".readout").text_content()
    assert gained.get_by_role("img").get_attribute("aria-label").endswith(told)


def test_what_is_wrong_is_a_sentence(console, visit):
    visited = visit(address(console, model=MODEL, trace="x/../y", episode=0))

    visited.page.get_by_text("'x/../y' is no trace of a model.").wait_for()
    visited.page.get_by_role("button", name="Try again").wait_for()
    visited.problems[:] = [each for each in visited.problems if "422" not in each]


def test_the_best_known_line_is_a_layer_that_can_be_switched(console, visit):
    lap = {"model": MODEL, "trace": EVALUATION, "episode": 0}
    page = visit(address(console, **lap)).page
    page.get_by_text("Best known line: The limit").wait_for()

    page.get_by_label("Best known line").uncheck()
    page.get_by_text("Best known line: The limit").wait_for(state="detached")

    assert "line=off" in page.url


@pytest.mark.nightly
@pytest.mark.parametrize("other", [{}, {"other_model": MODEL, "other_trace": EVALUATION}])
def test_a_lap_fits_and_is_read_and_reached(console, visit, other):
    other = other and {**other, "other_episode": 0}
    page = visit(address(console, model=MODEL, trace=EVALUATION, episode=0, **other)).page
    page.locator(".position").get_by_text("step 1 of").first.wait_for()
    page.get_by_role("img", name="Speed driven: from").first.wait_for()

    assert faults(page) == []
    assert unreached(page) == []
