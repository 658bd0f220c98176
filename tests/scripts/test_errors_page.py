"""The page of error texts is read from the code."""

from pathlib import Path

from errors_page import ErrorText, document, error_texts

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_is_current():
    page = (ROOT / "docs" / "errors.md").read_text("utf-8")

    assert page == document(), "run `python scripts/docs`"


def test_a_text_keeps_its_words_and_names_what_is_filled_in(tmp_path):
    package = tmp_path / "drcli"
    package.mkdir()
    (package / "a.py").write_text(
        "raise SettingsError(f'{where}: {len(names)} are ' + 'too many.', remedy='Take fewer.')\n"
        "raise ValueError('for programmers')\n"
    )

    texts = list(error_texts(tmp_path))

    assert texts == [ErrorText(3, "<where>: <len> are too many.", "Take fewer.")]


def test_every_refusal_of_a_command_names_a_remedy():
    """In the remedy, or in the text itself where the simulation speaks, which knows no commands."""
    without = [
        text
        for text in error_texts(ROOT)
        if not text.remedy and text.code != 3 and "<" not in text.message
    ]

    assert without == []
