"""No sentence of the page sends its reader to the terminal where the page does the same."""

import re
from pathlib import Path

import pytest

from drcli.base.errors import Problem, ProblemsError, SettingsError
from drcli.cli.completion import commands
from drcli.config.settings import catalogue
from drcli.web.answers import error_of, placed
from drcli.web.page_words import COMMANDS, OPTIONS, for_page, in_page
from drcli.web.topics import Snapshot

ROOT = Path(__file__).parents[3]
PAGES = ROOT / "drcli" / "web" / "pages"
SCRIPTS = {path.name: path.read_text() for path in PAGES.glob("*.js")}
ONLY_THERE = re.compile(r"`dr[- ](?!console)[a-z][^`]*`(?! in a terminal)")
"""A command that would stand in the page as if it were a part of it."""


def code_of(text: str) -> str:
    """A script without its comments."""
    return re.sub(r"^\s*(//|/\*\*|\*).*$|/\*.*?\*/", "", text, flags=re.MULTILINE)


def test_every_message_that_there_is_names_parts_of_the_page():
    said = [line for line in (ROOT / "docs" / "errors.md").read_text().splitlines() if "|" in line]
    left = [found for line in said for found in ONLY_THERE.findall(in_page(line))]

    assert len(said) > 500
    assert left == []


@pytest.mark.parametrize("script", sorted(SCRIPTS))
def test_the_page_itself_names_no_command(script):
    text = code_of(SCRIPTS[script])

    assert (
        re.findall(r"\bdr-[a-z-]+\b(?!:)", text.replace("dr-theme", "").replace("dr-tab", "")) == []
    )
    assert "env line" not in text


def test_what_stands_for_a_command_is_in_the_page():
    served = set((ROOT / "drcli/web").glob("*.py")) - {ROOT / "drcli/web/page_words.py"}
    everything = "".join([*SCRIPTS.values(), *(path.read_text() for path in served)])
    places = [*COMMANDS.values(), *OPTIONS.values()]
    named = {words for place in places for words in re.findall("“([^”]+)”", place)}

    assert {words for words in named if words not in everything} == set()


def test_every_setting_that_the_page_names_is_one():
    texts = [*SCRIPTS.values(), *(path.read_text() for path in (ROOT / "drcli/web").glob("*.py"))]
    named = set(re.findall(r"\bDR_[A-Z0-9_]*[A-Z0-9]\b(?!_)", "".join(texts)))

    assert named - catalogue().keys() == set()


def test_what_is_replaced_is_a_command():
    known = {name.removeprefix("dr-") for name in commands()}

    assert {name for name in COMMANDS if name[3:].split()[0] not in known | {"docs"}} == set()


@pytest.mark.parametrize(
    ("terminal", "page"),
    [
        ("Log in with `dr-car login --car 10.0.0.5`.", "Log in with “Log in” on the page “Car”."),
        (
            "Accept it with `dr-car login --new-certificate --car 10.0.0.5`.",
            "Accept it with `dr-car login --new-certificate --car 10.0.0.5` in a terminal.",
        ),
        ("`dr-list-models` lists all.", "The page “Models” lists all."),
        (
            "Wait. `dr-tracks list --all` shows all.",
            "Wait. The list of tracks on the page “New training” shows all.",
        ),
        (
            "Continue with `dr-start-training --resume`.",
            "Continue with “Resume the training” on the page of the model.",
        ),
        ("Make one with `dr-race create NAME`.", "Make one with “Make a race”."),
        ("Try `dr-car status`.", "Try the page “Car”."),
        ("Try `dr-car config`.", "Try `dr-car config` in a terminal."),
        ("`dr-export droa --distill` helps.", "`dr-export droa --distill` in a terminal helps."),
        (
            "Repeat this, or give up what is not saved with --now.",
            "Repeat this, or give up what is not saved with “Delete”.",
        ),
        (
            "Choose other types with --type, or use `dr-spot create --region`.",
            "Choose other types with `dr-spot create --type` in a terminal, or use “Start a spot "
            "training” on the page “Spot”.",
        ),
        ("Leave out --now-or-never.", "Leave out --now-or-never."),
        ("Type `dr console restart`.", "Type `dr console restart`."),
        ("experiments/a/run.env line 26 is wrong.", "experiments/a/run.env is wrong."),
        ("Choose another name with -p; -w would delete that model.", "Choose another name."),
        ("Make room, and run the command again.", "Make room, and try again."),
        ("Is it b? `dr-list-models` lists all.", "Is it b? The page “Models” lists all."),
    ],
)
def test_a_sentence_has_a_form_for_the_page(terminal, page):
    assert in_page(terminal) == page
    assert in_page(page) == page


def test_sentences_are_said_so_in_answers_problems_and_topics():
    sentence, words = "Look at `dr-status`.", "Look at the page “Live”."
    problem = Problem("V-12", "error", "run.env", 26, f"DR_X=1 is wrong. {sentence}", "", "DR_X")

    assert error_of(SettingsError("No.", remedy=sentence))["error"]["remedy"] == words
    assert placed(problem)["where"] == ""
    assert error_of(ProblemsError([problem]))["error"]["message"] == f"DR_X=1 is wrong. {words}"
    assert words in Snapshot.of("t", {"rows": [{"warnings": [sentence]}]}).text.replace(
        "\\u201c", "“"
    ).replace("\\u201d", "”")
    assert for_page({"text": sentence}) == {"text": sentence}  # what a racer wrote
