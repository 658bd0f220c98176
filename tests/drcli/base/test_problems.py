"""Problems: how they read, sort and end a command."""

import pytest

from drcli.base.errors import Place, Problem, ProblemsError, of_severity, refuse


def problem(message="LR=2 is above 1.", *, rule="V-41", severity="error", line=3, file="a.json"):
    return Problem(rule, severity, file, line, message, "Write 1.", "LR")


@pytest.mark.parametrize(
    ("place", "text"),
    [(Place("run.env", 7), "run.env line 7"), (Place("environment"), "environment")],
)
def test_a_place_reads_as_file_and_line(place, text):
    assert str(place) == text


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (problem(), "a.json line 3: LR=2 is above 1."),
        (problem(file="", line=None), "LR=2 is above 1."),
        (problem("s3://b/m exists.", file="s3://b/m", line=None), "s3://b/m exists."),
        (problem("LR is in a.json line 3, too."), "LR is in a.json line 3, too."),
        (problem("See a.json line 3."), "See a.json line 3."),
        (
            problem("LR is set in a.json line 34, too."),
            "a.json line 3: LR is set in a.json line 34, too.",
        ),
        (problem("See my-a.json line 3."), "a.json line 3: See my-a.json line 3."),
        (problem("See a.json.bak.", line=None), "a.json: See a.json.bak."),
    ],
)
def test_a_problem_reads_as_its_place_and_its_message(given, sentence):
    assert str(given) == sentence


def test_programs_read_the_place_as_one_text():
    assert problem().as_json() == {
        "rule": "V-41",
        "severity": "error",
        "where": "a.json line 3",
        "message": "LR=2 is above 1.",
        "remedy": "Write 1.",
    }


def test_problems_are_sorted_by_rule_file_and_line_and_each_comes_once():
    late, early, other = problem(line=10), problem(line=9), problem(rule="V-02", line=99)
    odd = problem(severity="warning")

    assert of_severity([late, odd, early, other, late], "error") == (other, early, late)


def test_an_error_has_a_line_and_a_remedy_for_each_problem_that_is_one():
    quoted = problem("It fails.\n  return x", line=None)

    with pytest.raises(ProblemsError) as refusal:
        refuse([problem(), problem(severity="warning"), quoted])

    assert str(refusal.value).splitlines() == [
        "a.json: It fails. return x",
        "a.json line 3: LR=2 is above 1.",
    ]
    assert refusal.value.remedy == "Write 1.\nWrite 1."
    assert refusal.value.code == 3


def test_warnings_alone_are_not_refused():
    refuse([problem(severity="warning"), problem(severity="note")])
