"""The page of error texts is read from the code."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def script():
    """The script as a module; `scripts` is no package."""
    spec = importlib.util.spec_from_file_location(
        "error_texts", ROOT / "scripts" / "error_texts.py"
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["error_texts"] = module
    spec.loader.exec_module(module)
    return module


def test_the_page_is_current(script):
    page = (ROOT / "docs" / "errors.md").read_text("utf-8")

    assert page == script.document(), "run scripts/write_docs.py"


def test_a_text_keeps_its_words_and_names_what_is_filled_in(script, tmp_path):
    package = tmp_path / "drcli"
    package.mkdir()
    (package / "a.py").write_text(
        "raise SettingsError(f'{where}: {len(names)} are ' + 'too many.', remedy='Take fewer.')\n"
        "raise ValueError('for programmers')\n"
    )

    texts = list(script.error_texts(tmp_path))

    assert texts == [script.ErrorText(3, "<where>: <len> are too many.", "Take fewer.")]


def test_every_refusal_of_a_command_names_a_remedy(script):
    """In the remedy, or in the text itself where the simulation speaks, which knows no commands."""
    without = [
        text
        for text in script.error_texts(ROOT)
        if not text.remedy and text.code != 3 and "<" not in text.message
    ]

    assert without == []
