"""docs/settings.md says what the code says."""

from pathlib import Path

from settings_page import document

from drcli.config.settings import catalogue
from drcli.config.unused_names import FORMER

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_is_current_or_else_run_the_script():
    assert (ROOT / "docs" / "settings.md").read_text("utf-8") == document()


def test_every_setting_has_one_row():
    rows = [line for line in document().splitlines() if line.startswith("| `DR_")]

    assert sorted(row.split("`")[1] for row in rows) == sorted([*catalogue(), *FORMER])


def test_a_row_holds_default_meaning_range_and_file():
    assert (
        "| `DR_WORKERS` | `1` | Number of simulation processes, here or with DR_LAUNCHER=ray in "
        "the cluster; deepracer-utils reads the first 10. With 0, all join from elsewhere "
        "(`dr-start-worker`). "
        "| a whole number from 0 to 1000 | system.env |" in document().splitlines()
    )


def test_a_setting_without_effect_says_why():
    rows = [line for line in document().splitlines() if line.startswith("| `DR_DOCKER_STYLE`")]

    assert rows == ["| `DR_DOCKER_STYLE` | How containers are started. | no containers are used |"]
