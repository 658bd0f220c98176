"""Questions, and what counts as an answer."""

import io

import pytest

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
