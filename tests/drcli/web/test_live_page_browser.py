"""The live page in a browser: a worker that comes, is watched, and goes; the log; keyboard."""

import re
import threading

import pytest

from drcli.records.run_record import log_file
from live_worker import SmallDrive, shown


@pytest.fixture
def driving(served):
    """A worker that drives until the block is left."""
    drive = SmallDrive()
    ended = threading.Event()

    class Ended(Exception):
        pass

    def rest():
        if ended.wait(0.02):
            raise Ended

    class Driving:
        name = "sim-0"

        def __enter__(self):
            ended.clear()
            self._shown = shown(served.folder, name=self.name)
            show, _ = self._shown.__enter__()
            self.show = show
            self._thread = threading.Thread(target=self._drive, args=(show,), daemon=True)
            self._thread.start()
            return show

        def _drive(self, show):
            try:
                while True:
                    drive.episodes(show, after_step=rest)
            except Ended:
                pass

        def __exit__(self, *_):
            ended.set()
            self._thread.join(20.0)
            self._shown.__exit__(None, None, None)

    yield Driving()
    drive.close()


def test_a_worker_is_shown_while_it_runs(served, visit, driving):
    page = visit(served.url, width=800).page
    page.get_by_text("There is no training yet.").wait_for()
    page.get_by_text("No worker runs now.").wait_for()
    with driving:
        card = page.locator("article[data-worker=sim-0]")
        card.get_by_text("Drives iteration 3.").wait_for()
        card.scroll_into_view_if_needed()
        card.locator("figcaption").filter(has_text=re.compile(r"Camera, car \d")).wait_for()
        camera = card.get_by_role("img", name="What the car of sim-0 sees")
        assert float(camera.get_attribute("data-age-ms")) < 20_000
        card.get_by_text("2 cars, reinvent_base").wait_for()
        # The word says the side, so the number has no sign.
        card.get_by_text(re.compile(r"^\d+° right$")).wait_for()


def test_the_log_follows_its_file_and_can_be_paused(served, visit):
    log = log_file(served.folder, "model", "trainer")
    page = visit(served.url, width=360, theme="dark").page
    panel = page.get_by_role("log")
    page.get_by_text("There is no log of trainer on this machine yet.").wait_for()
    log.parent.mkdir(parents=True)
    log.write_text("first line\n")
    panel.get_by_text("first line").wait_for()
    page.get_by_role("button", name="Pause").press("Enter")
    with log.open("a") as file:
        file.write("second line\n")
    page.get_by_text("Paused. 1 new line since.").wait_for()
    assert "second" not in panel.inner_text()
    page.get_by_role("button", name="Go on").press("Enter")
    panel.get_by_text("second line").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= 360


def test_names_of_settings_in_advice_are_shown_as_code(served, visit):
    page = visit(served.url).page
    shown_codes = page.evaluate(
        """async (run) => {
            const { runState } = await import("/live_state.js");
            const { element, setRun } = runState(0, new AbortController().signal);
            setRun(run);
            const list = element.querySelector(".live-said");
            return [list.textContent, [...list.querySelectorAll("code")].map((e) => e.textContent)];
        }""",
        {
            "state": "stopped",
            "prefix": "first",
            "world": "reinvent_base",
            "iterations_left": None,
            "warning": "the car zigzags",
            "advice": ["Reward less steering, or lower `discount_factor`."],
        },
    )

    assert shown_codes == [
        "Learning curve: the car zigzags. Reward less steering, or lower discount_factor.",
        ["discount_factor"],
    ]


def test_the_card_of_an_evaluation_is_headed_by_its_model(served, visit, driving):
    driving.name = "evaluation-20260102030405"
    page = visit(served.url).page
    with driving:
        page.get_by_role("heading", name="Evaluation of model-1").wait_for()


def test_a_worker_that_was_started_again_is_not_said_to_be_just_starting(served, visit):
    page = visit(served.url).page
    page.get_by_text("There is no training yet.").wait_for()

    told = page.evaluate(
        """async () => {
            const { workerCard } = await import("/live_worker.js");
            const card = workerCard(0, "sim-0", new AbortController().signal);
            const texts = [];
            for (const facts of [{ alive: true, restarts: 2 }, { alive: true, restarts: 0 }, {}]) {
                card.update({ place: "here", activity: "starts", world: null, ...facts });
                texts.push(card.element.textContent);
            }
            return texts;
        }"""
    )

    assert "it was started again (2 times by now)" in told[0]
    assert "it is just starting" in told[1]
    assert "It has ended before its time." in told[2]


def test_a_button_that_is_replaced_leaves_the_focus_to_the_next_one(served, visit):
    page = visit(served.url).page
    page.get_by_text("There is no training yet.").wait_for()

    focused = page.evaluate(
        """async () => {
            const { fillButtons, h } = await import("/dom.js");
            const place = h("p", {}, h("button", { id: "before" }, "Stop"));
            document.getElementById("main").append(place);
            const found = [];
            const tell = () => found.push(document.activeElement.id);
            document.getElementById("before").focus();
            const off = h("button", { id: "off", disabled: true });
            fillButtons(place, off, h("button", { id: "on" }));
            tell();
            fillButtons(place, document.getElementById("on"), h("button", { id: "more" }, "More"));
            tell();
            fillButtons(place);
            tell();
            document.body.focus();
            document.activeElement.blur();
            fillButtons(place, h("button", { id: "late" }, "Start"));
            tell();
            return found;
        }"""
    )

    assert focused == ["on", "on", "main", ""]
