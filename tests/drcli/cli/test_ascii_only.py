"""What a terminal shows that does not know our signs."""

import io

import pytest

from drcli.cli import app
from drcli.cli.show import ALL, BLOCKS, NONE, SOME


@pytest.fixture
def shown():
    """What arrives at a terminal of a character set."""

    def write(text: str, encoding: str) -> str:
        raw = io.BytesIO()
        stream = io.TextIOWrapper(raw, encoding=encoding)
        app.use(stream)
        stream.write(text)
        stream.flush()
        return raw.getvalue().decode(encoding)

    return write


@pytest.mark.parametrize("encoding", ["ascii", "iso8859-1"])
def test_a_map_is_drawn_with_letters_that_every_terminal_has(shown, encoding):
    assert shown("\u28c0\u28ff\u2190\u28ff S \u2199", encoding) == ".#<# S /"


def test_heights_and_marks_stay_apart(shown):
    for signs in (BLOCKS, NONE + SOME + ALL, "→↗↑↖←↓"):
        plain = shown(signs, "ascii")

        assert len(set(plain)) == len(plain)
        assert "?" not in plain


def test_other_letters_become_question_marks_one_each(shown):
    assert shown("Müller 赛道", "ascii") == "M?ller ??"
    assert shown("Müller 赛道", "iso8859-1") == "Müller ??"


def test_a_terminal_that_knows_the_signs_gets_them(shown):
    assert shown("\u28ff\u2190▂", "utf-8") == "\u28ff\u2190▂"
