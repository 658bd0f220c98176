"""docs/requirements.md names all 125 numbers, with commands, pages and tests that exist."""

import re
from pathlib import Path

import pytest

from drcli.config.settings import catalogue
from written_commands import problem_of

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "requirements.md"

COUNTS = {"000": 26, "001": 53, "002": 17, "003": 20, "004": 9}
"""How many things each document asks for."""

ROW = re.compile(r"^\| (\d{3}-\d\d) \| (.+?) \| (.+?) \| \[(.+?)\]\((.+?)\) \| (`.+`) \|$")


def rows() -> list[tuple[str, ...]]:
    """Number, request, commands and settings, title, page and tests of each row."""
    lines = PAGE.read_text("utf-8").splitlines()
    return [match.groups() for line in lines if (match := ROW.match(line))]


def test_every_number_is_there_once_and_in_order():
    wanted = [f"{doc}-{k:02}" for doc, count in COUNTS.items() for k in range(1, count + 1)]

    assert len(wanted) == 125
    assert [row[0] for row in rows()] == wanted


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[0])
def test_what_a_row_names_exists(row):
    _, _, how, _, page, tests = row

    assert (ROOT / "docs" / page).is_file(), page
    for test in re.findall(r"`([^`]+)`", tests):
        assert (ROOT / test).is_file(), test
    for code in re.findall(r"`([^`]+)`", how):
        if code.startswith("DR_"):
            assert code in catalogue(), code
        elif code.startswith(("dr-", "droa-")):
            problem = problem_of(code.replace("...", "x"))
            assert not problem, problem
        elif code.startswith(("python scripts/", "scripts/")):
            assert (ROOT / code.removeprefix("python ").split()[0]).exists(), code
