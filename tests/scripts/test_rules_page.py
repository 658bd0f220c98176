"""docs/validation.md says what the rules say."""

from pathlib import Path

from rules_page import document

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_is_current():
    page = (ROOT / "docs" / "validation.md").read_text("utf-8")

    assert page == document(), "Run `python scripts/docs`."
