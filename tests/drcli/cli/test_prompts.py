"""Questions, and what counts as an answer."""

import io
import os
import pty
import signal

import pytest

from drcli.base.errors import Aborted
from drcli.cli import prompts


@pytest.mark.parametrize(
    ("typed", "answer"),
    [("\n", "local"), ("aws\n", "aws"), ("AWS\n", "aws"), ("x\naws\n", "aws"), ("", "local")],
)
def test_a_question_is_put_until_the_answer_is_one_of_the_words(monkeypatch, capsys, typed, answer):
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))

    assert prompts.ask("Who keeps the bucket", "local", ["local", "aws"]) == answer
    assert capsys.readouterr().err.startswith("Who keeps the bucket (local, aws) [local]: ")


def test_a_question_without_words_takes_anything(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("  my model \n"))

    assert prompts.ask("Name of the model", "m") == "my model"


ASKED = {
    "agree": lambda: prompts.agree("Delete it?", yes=False, remedy="Add -f."),
    "ask": lambda: prompts.ask("Name of the model", "m"),
    "secret": lambda: prompts.secret("Password", "Add -f."),
}


@pytest.fixture
def terminal(monkeypatch):
    """A terminal with nobody at it, as the cell of a notebook has; its other end."""
    other_end, own = pty.openpty()
    with os.fdopen(own, "r+b", buffering=0) as file, io.TextIOWrapper(file) as stream:
        monkeypatch.setattr("sys.stdin", stream)
        monkeypatch.setattr("getpass.getpass", lambda prompt: stream.readline())
        yield other_end
    os.close(other_end)


@pytest.mark.parametrize("question", ASKED)
def test_a_question_that_nobody_answers_is_answered_with_no(terminal, monkeypatch, question):
    monkeypatch.setattr(prompts, "PATIENCE_S", 0.05)
    before = signal.getsignal(signal.SIGALRM)

    with pytest.raises(Aborted, match="Nobody answered within a minute") as end:
        ASKED[question]()

    assert "-f" in end.value.remedy
    assert signal.getsignal(signal.SIGALRM) is before


def test_an_answer_on_a_terminal_counts(terminal):
    os.write(terminal, b"y\n")

    ASKED["agree"]()
