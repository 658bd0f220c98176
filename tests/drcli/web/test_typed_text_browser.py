"""What was typed into a form is there again, in whatever way the page was left."""

import random
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from home_races import Home
from served_console import ServedConsole, served_console

TYPED = "7"
"""A text that every field takes."""


class Leaving:
    """A page with a form, and the console that serves it."""

    def __init__(self, folder: Path, context: Any, path: str, stack: ExitStack) -> None:
        self.folder, self.context, self.path, self.stack = folder, context, path, stack
        self.served = self.start(0)
        self.page = context.new_page()
        self.page.goto(f"{self.url}/")
        self.page.get_by_role("heading", name="Live").wait_for()
        self.page.goto(f"{self.url}/#{path}")

    def start(self, port: int) -> ServedConsole:
        self.stack.close()
        return self.stack.enter_context(served_console(self.folder, port=port))

    @property
    def url(self) -> str:
        return self.served.url

    def return_here(self) -> None:
        self.page.evaluate("path => { location.hash = path; }", self.path)

    def by_link(self) -> None:
        self.page.get_by_role("link", name="Episodes").first.evaluate("link => link.click()")
        self.page.get_by_role("heading", name="Episodes").wait_for()
        self.return_here()

    def by_brand(self) -> None:
        self.page.locator(".brand").evaluate("link => link.click()")
        self.page.get_by_role("heading", name="Live").wait_for()
        self.return_here()

    def by_back(self) -> None:
        self.page.go_back()
        self.page.get_by_role("heading", name="Live").wait_for()
        self.page.go_forward()

    def by_forward(self) -> None:
        self.page.evaluate("location.hash = '#/play'")
        self.page.get_by_role("heading", name="Episodes").wait_for()
        self.page.go_back()

    def by_reload(self) -> None:
        self.page.reload()

    def by_address(self) -> None:
        self.page.evaluate("location.hash = '#/nowhere'")
        self.page.get_by_role("heading", name="There is no such page").wait_for()
        self.return_here()

    def by_skip_link(self) -> None:
        self.page.locator("#skip").evaluate("link => link.click()")

    def by_another_site(self) -> None:
        self.page.goto("about:blank")
        self.page.goto(f"{self.url}/#{self.path}")

    def by_theme(self) -> None:
        self.page.locator("#theme").evaluate("button => button.click()")

    def by_escape(self) -> None:
        self.page.keyboard.press("Escape")

    def by_a_console_that_was_killed(self) -> None:
        self.stack.close()
        self.page.locator("#connection.away").wait_for()
        self.served = self.start(self.served.port)
        self.page.get_by_text("Connected").wait_for()

    def by_a_closed_tab(self) -> None:
        self.page.close()
        self.page = self.context.new_page()
        self.page.goto(f"{self.url}/#{self.path}")

    def by_a_second_tab(self) -> None:
        second = self.context.new_page()
        second.goto(f"{self.url}/#{self.path}")
        second.get_by_role("heading").first.wait_for()
        self.page.reload()


WAYS = [name for name in vars(Leaving) if name.startswith("by_")]
FORMS: dict[str, tuple[str, str, str]] = {
    "reward function": ("/new", "", "Reward function"),
    "hyperparameter": ("/new", "", "batch_size"),
    "action": ("/new", "", "Speed of action 1"),
    "name of a model": ("/new", "", "Name of the model DR_LOCAL_S3_MODEL_PREFIX"),
    "seed": ("/new", "", "Seed (this start only)"),
    "setting": ("/settings", "Names and places", "DR_RACER_NAME"),
    "race": ("/races?new=1", "", "Name"),
    "rules": ("/race/cup", "Change the rules", "Laps"),
    "submission": ("/race/cup", "Submit a model", "Racer"),
    "note": ("/model?prefix=ann&tab=notes", "", "New note"),
    "description": ("/model?prefix=ann&tab=notes", "Describe the model", "Text"),
    "clone": ("/model?prefix=ann", "Clone", "What is it for?"),
    "evaluation": ("/model?prefix=ann", "Evaluate", "Laps"),
}
DRAWN = random.Random(40).sample([(form, way) for form in FORMS for way in WAYS], 30)


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as open_ones:
        yield open_ones


@pytest.fixture
def context(browser: Any) -> Iterator[Any]:
    made = browser.new_context(viewport={"width": 1280, "height": 900})
    made.set_default_timeout(60_000)
    yield made
    made.close()


def shown(page: Any, form: str) -> Any:
    """The field, after what shows it was pressed."""
    _, opener, label = FORMS[form]
    field = page.get_by_label(label, exact=label != "DR_RACER_NAME")
    page.get_by_role("heading").first.wait_for()
    if form == "setting":
        page.get_by_label("Search settings").fill("racer_name")
    elif opener and not field.count():
        page.get_by_role("button", name=opener, exact=True).click()
    field.wait_for()
    return field


@pytest.mark.nightly
@pytest.mark.parametrize(("form", "way"), DRAWN)
def test_typed_text_is_there_again(home: Home, stack, context, form: str, way: str):
    home.race()
    own = home.folder / "custom_files"
    own.mkdir()
    (own / "reward_function.py").write_text("def reward_function(params):\n    return 1.0 +\n")
    at = Leaving(home.folder, context, FORMS[form][0], stack)
    shown(at.page, form).fill(TYPED)

    leave: Callable[[], None] = getattr(at, way)
    leave()

    field = shown(at.page, form)
    offered = at.page.get_by_role("button", name="Show them")
    if way == "by_a_closed_tab":
        offered.first.click()
    assert field.input_value() == TYPED
