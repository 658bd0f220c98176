"""Conditions on `steps` that come out the same in every call, in the ways people write them."""

import ast
from pathlib import Path

import pytest

from drcli.rewards.reward_rules import idle_conditions

DEFAULTS = Path(__file__).resolve().parents[3] / "defaults"


def told(*body: str) -> list[tuple[str, bool]]:
    """Conditions found in a function of these lines: each as written, and what it always is."""
    text = "def reward_function(params):\n" + "".join(f"    {line}\n" for line in body)
    return [(idle.text, idle.holds) for idle in idle_conditions(ast.parse(text))]


@pytest.mark.parametrize(
    "condition",
    [
        "params['steps'] == 0",
        "params['steps'] == 1",
        "1 == params['steps']",
        "params.get('steps', 0) == 0",
        "int(params['steps']) == 1",
        "params['steps'] <= 1",
        "params['steps'] < 2",
        "2 > params['steps']",
        "params['steps'] in (0, 1)",
        "0 <= params['steps'] <= 1",
        "not params['steps']",
        "params['steps'] == 2.5",
    ],
)
def test_a_step_before_the_first_paid_one_never_comes(condition):
    assert told(f"return 1.0 if {condition} else 2.0") == [(condition, False)]


@pytest.mark.parametrize(
    "condition", ["params['steps'] > 1", "params['steps'] >= 2", "params['steps'] != 1"]
)
def test_not_being_in_step_1_is_always_so(condition):
    assert told(f"if {condition}:", "    return 1.0", "return 2.0") == [(condition, True)]


@pytest.mark.parametrize(
    "condition",
    [
        "params['steps'] == 2",
        "params['steps'] <= 2",
        "params['steps'] < 3",
        "params['steps'] > 2",
        "1 < params['steps'] < 90",
        "params['steps'] % 100 == 0",
        "params['steps'] in (0, 75)",
        "params['steps'] == params['progress']",
        "params['progress'] == 1",
        "params['steps'] > 0",  # such guards of a division are right and do no harm
        "params['steps'] != 0",
        "params['steps'] >= 1",
    ],
)
def test_what_depends_on_the_step_or_guards_a_division_is_not_told(condition):
    assert told(f"return 1.0 if {condition} else 2.0") == []


@pytest.mark.parametrize(
    ("lines", "condition"),
    [
        (["steps = params['steps']", "if steps == 1:"], "steps == 1"),
        (["x, n = params['x'], params['steps']", "if n == 1:"], "n == 1"),
        (["if (n := params['steps']) == 1:"], "(n := params['steps']) == 1"),
        (["n: int = int(params['steps'])", "k = n", "if k == 1:"], "k == 1"),
    ],
)
def test_steps_are_known_by_the_names_they_are_given(lines, condition):
    assert told(*lines, "    return 1.0", "return 2.0") == [(condition, False)]


@pytest.mark.parametrize(
    "lines",
    [
        ["k = 0", "if k == 0:"],
        ["steps = params['steps']", "steps -= 2", "if steps == 0:"],
        ["for steps in range(3):", "    pass", "if steps == 0:"],
        ["steps = params['steps']", "steps, rest = divmod(steps, 2)", "if steps == 0:"],
        ["steps = params['steps']", "if any(steps == 0 for steps in [0, 1]):"],
    ],
)
def test_names_that_hold_something_else_as_well_are_left_alone(lines):
    assert told(*lines, "    return 1.0", "return 2.0") == []


def test_names_and_attributes_count_in_the_function_that_gives_them():
    text = """
class Racer:
    def __init__(self):
        self.before = 0

    def reward_function(self, params):
        self.steps = params["steps"]
        if self.steps == 1:
            self.start()
        if self.before == 0:
            self.start()
        return self.bonus(self.steps)

    def bonus(self, steps):
        return 5.0 if steps == 1 else 1.0


reward_function = Racer().reward_function
"""

    assert [(idle.line, idle.text) for idle in idle_conditions(ast.parse(text))] == [
        (8, "self.steps == 1")
    ]


def test_the_message_says_what_the_first_call_has_and_how_to_ask_for_it():
    (never,) = idle_conditions(
        ast.parse("def reward_function(params):\n    return params['steps'] == 0\n")
    )

    assert never.line == 2
    assert never.message.startswith("`params['steps'] == 0` is never true: the first call")
    assert "`steps <= 2`" in never.remedy


def test_no_example_waits_for_a_step_that_never_comes():
    files = sorted(DEFAULTS.rglob("reward_function.py"))

    assert len(files) == 10
    assert [
        idle for file in files for idle in idle_conditions(ast.parse(file.read_text("utf-8")))
    ] == []


def test_a_set_that_python_cannot_make_is_not_a_condition():
    assert (
        idle_conditions(
            ast.parse("def reward_function(params):\n    return params['steps'] in {[1]}\n")
        )
        == []
    )
