"""The live page in a browser: a worker that comes, is watched, and goes; the log; keyboard."""

import re

import pytest

from drcli.records.run_record import log_file
from live_worker import driving


def test_a_worker_is_shown_while_it_runs(served, visit):
    page = visit(served.url, width=800).page
    page.get_by_text("There is no training yet.").wait_for()
    page.get_by_text("No worker runs now.").wait_for()
    with driving(served.folder):
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


def drawn(page, module, component, props):
    """The text of a component, its code words and its links."""
    return page.evaluate(
        """async ([module, component, props]) => {
            const { html, render } = await import("/ui.js");
            const part = (await import(module))[component];
            const place = document.createElement("div");
            render(html`<${part} ...${props} />`, place);
            const texts = (tag, of) => [...place.querySelectorAll(tag)].map(of);
            return {
                text: place.textContent.replace(/\\s+/g, " "),
                codes: texts("code", (each) => each.textContent),
                links: texts("a", (each) => [each.textContent, each.getAttribute("href")]),
            };
        }""",
        [module, component, props],
    )


def state_of(page, said=(), **run):
    """How the live page tells a run."""
    usual = {"state": "stopped", "prefix": "first", "message": "", "remedy": ""}
    words = {"active": False, "own": True, "dot": "", "sentence": "", "hint": "", "figures": []}
    props = {"run": {**usual, **run, "words": {**words, "said": list(said)}}, "elsewhere": None}
    return drawn(page, "/live_page.js", "State", props)


def test_names_of_settings_in_advice_are_shown_as_code(served, visit):
    page = visit(served.url).page

    remedy = "Reward less steering, or lower `discount_factor`."
    told = state_of(page, [{"kind": "warn", "message": "The car zigzags.", "remedy": remedy}])

    assert "The car zigzags. Reward less steering, or lower discount_factor." in told["text"]
    assert "discount_factor" in told["codes"]


@pytest.mark.parametrize(
    ("message", "link"),
    [
        (
            "custom_files/reward_function.py, line 7: NameError: name 'x' is not defined",
            ["Open line 7", "#/new?step=reward&line=7"],
        ),
        (
            "The reward function failed in each call.",
            ["Open the reward function", "#/new?step=reward"],
        ),
        (
            "custom_files/hyperparameters.json: lr is 5, above 1.",
            ["Open the hyperparameters", "#/new?step=hyperparameters"],
        ),
        (
            "run.env, line 3: DR_WORKERS is 0, below 1.",
            ["Open DR_WORKERS", "#/settings?name=DR_WORKERS"],
        ),
    ],
)
def test_a_training_that_failed_leads_to_what_must_be_mended(served, visit, message, link):
    page = visit(served.url).page

    told = state_of(page, state="failed", message=message, remedy="Correct it.")

    assert told["links"][0] == link
    assert message in told["text"]


def test_the_card_of_an_evaluation_is_headed_by_its_model(served, visit):
    page = visit(served.url).page
    with driving(served.folder, "evaluation-20260102030405"):
        page.get_by_role("heading", name="Evaluation of model-1").wait_for()
