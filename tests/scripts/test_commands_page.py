"""docs/commands.md and the table of the reference's commands."""

import re
from pathlib import Path

import pytest
from commands_page import document
from drfc_commands import REFERENCE, SCRIPTS, missing

from drcli.checks.explain.explain_texts import EXIT_CODES
from drcli.cli.command_line import EPILOG
from drcli.cli.command_table import COMMANDS, program_names

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def page() -> str:
    return document()


def test_the_page_in_docs_is_what_the_commands_say(page):
    written = (ROOT / "docs" / "commands.md").read_text("utf-8")

    assert written == page, "Run `python scripts/docs`."


def test_every_command_of_the_reference_that_is_kept_exists():
    assert missing() == []
    assert [script for script in SCRIPTS if not (ROOT / script).exists()] == []


def test_nothing_of_the_reference_is_called_not_needed_that_a_command_of_ours_does():
    idle = [row.name for row in REFERENCE if row.verdict == "not needed"]
    words = [command.name for command in COMMANDS]

    assert [(name, word) for name in idle for word in words if word in name] == []


def test_the_table_of_the_reference_names_nothing_twice():
    names = [row.name for row in REFERENCE]

    assert len(names) == len(set(names))


def test_every_program_has_a_section_with_an_example(page):
    titles = re.findall(r"^### (.+)$", page, re.MULTILINE)
    sections = re.split(r"^### .+$", page, flags=re.MULTILINE)[1:]

    former = {command.name for command in COMMANDS if command.same_as}
    programs = {program for program, name in program_names().items() if name not in former}
    assert set(titles) == programs - {"dr"}
    for title, section in zip(titles, sections, strict=True):
        assert "```sh\ndr" in section, title


def test_every_link_of_the_page_leads_to_a_section(page):
    titles = re.findall(r"^### (.+)$", page, re.MULTILINE)

    assert set(re.findall(r"\]\(#([^)]+)\)", page)) <= set(titles)


def test_the_page_and_the_help_know_the_same_exit_codes():
    listed = re.findall(r"^ +(\d+)  ", EPILOG, re.MULTILINE)

    assert [int(code) for code in listed] == list(EXIT_CODES)
