"""Which rewards are said to have loopholes, and how findings are put into words."""

import runpy
from pathlib import Path

import pytest

from drcli.checks.first_step import idle_conditions
from drcli.checks.sandbox.statement import (
    Difference,
    Effect,
    Failure,
    Growth,
    Place,
    Printed,
    Statement,
    Timing,
)
from drcli.rewards.lint import remarks
from drcli.rewards.trial import Trial

DEFAULTS = Path(__file__).resolve().parents[3] / "defaults"


def on_the_road(params):
    return params["all_wheels_on_track"] and not params["is_offtrack"]


@pytest.fixture
def rules(trial_of):
    def of(function) -> list[str]:
        return [remark.rule for remark in remarks(trial_of(function))]

    return of


def test_a_constant_reward_is_told_and_nothing_follows_from_it(rules):
    assert rules(lambda params: 1.0) == ["constant"]


def test_pay_for_speed_alone_cancels_out(rules, trial_of):
    found = remarks(trial_of(lambda params: params["speed"] if on_the_road(params) else 0.0))

    assert [remark.rule for remark in found] == ["cancels-out"]
    assert "12.1 s" in found[0].message


def test_pay_by_the_step_is_more_for_a_slow_lap(rules):
    assert rules(lambda params: 0.1 + params["speed"] ** 0.1 * on_the_road(params)) == ["slow-lap"]


def test_pay_for_standing_is_told(rules):
    found = rules(lambda params: 1.0 if on_the_road(params) else 0.0)

    assert found == ["standing"]


def test_a_car_off_the_road_that_is_paid_as_before_is_told(rules):
    assert rules(lambda params: params["speed"] ** 2) == ["off-track"]


def test_a_lap_that_costs_more_than_its_end_is_told(rules):
    assert rules(lambda params: -1.0 - params["distance_from_center"]) == ["short"]


def test_pay_that_grows_with_every_step_is_told(rules):
    found = rules(lambda params: params["steps"] ** 2 / 1e3 if on_the_road(params) else 0.0)

    assert "unbounded" in found


def test_the_size_of_rewards_is_no_reason_to_complain(rules):
    assert rules(lambda params: 4e3 * on_the_road(params) * params["speed"] ** 2) == rules(
        lambda params: on_the_road(params) * params["speed"] ** 2
    )


def test_the_shipped_example_for_speed_has_no_loophole(rules):
    shipped = runpy.run_path(str(DEFAULTS / "rewards" / "speed" / "reward_function.py"))

    assert rules(shipped["reward_function"]) == []


def test_the_shipped_example_is_known_to_pay_a_slow_lap_more(rules):
    shipped = runpy.run_path(str(DEFAULTS / "reward_function.py"))

    assert rules(shipped["reward_function"]) == ["standing"]


@pytest.fixture
def told(course):
    """What is said about a statement, by rule."""

    def of(**facts):
        values = [[float(k % 7) for k in range(len(c))] for c in course.questions().sequences]
        statement = Statement(values=values, **{"made": course.size, **facts})
        return {remark.rule: remark for remark in remarks(Trial("mine.py", course, statement))}

    return of


def test_a_failure_may_bring_a_remedy_of_its_own(told):
    failure = Failure(kind="load", what="It fails.", line=1, source="", remedy="Do so.", times=1)

    assert told(failures=[failure])["loads"].remedy == "Do so."


def test_what_is_put_in_place_of_pythons_own_is_an_error(told):
    remark = told(replaced=["math.sqrt", "builtins.len"])["replaces"]

    assert remark.severity == "error"
    assert "in place of math.sqrt, builtins.len." in remark.message


def test_waiting_for_a_step_that_never_comes_is_told_with_its_line(told):
    idle = idle_conditions("def reward_function(params):\n    return params['steps'] == 1\n")

    remark = told(idle=idle)["first-step"]

    assert (remark.severity, remark.where) == ("warning", "mine.py line 2")
    assert "is never true" in remark.message


def test_one_is_counted_as_one(told):
    found = told(effects=[Effect(kind="waits", what="10 s", line=3, times=1)], made=1)

    assert "(1 time in 1 call)" in found["waits"].message


@pytest.mark.parametrize(
    ("value", "other", "shown"),
    [
        (96.15, 17.0, ("96.15", "17")),
        (96.1512, 96.1514, ("96.1512", "96.1514")),
        (96.15, 96.15 + 1e-9, ("96.15", "96.150000001")),
        (0.1 + 0.2, 0.3, ("0.30000000000000004", "0.29999999999999999")),
        (None, 2.0, ("a failure", "2")),
    ],
)
@pytest.mark.parametrize(("rule", "word"), [("memory", "or"), ("random", "and")])
def test_two_values_are_shown_with_enough_digits_to_tell_them_apart(
    told, rule, word, value, other, shown
):
    place = Place(sequence=0, index=1)
    found = Difference(place=place, value=value, other=other, times=1, of=9)

    assert f"{shown[0]} {word} {shown[1]} (" in told(**{rule: found})[rule].message


def test_effects_and_habits_are_put_into_words_errors_first(course):
    values = [[float(k % 7) for k in range(len(calls))] for calls in course.questions().sequences]
    statement = Statement(
        values=values,
        made=course.size,
        effects=[
            Effect(kind="reads", what="line.npy", line=3, times=1),
            Effect(kind="writes", what="log.txt", line=9, times=500),
        ],
        printed=Printed(lines=course.size, characters=20 * course.size, line=7, calls=course.size),
        growing=[Growth(name="SEEN", before=10, after=110, calls=100)],
        changed={"speed": 3},
        unknown={"sped": 5},
        timing=Timing(
            median_s=1e-3, mean_s=1e-3, worst_s=2.0, worst=Place(sequence=0, index=1), load_s=0.1
        ),
    )

    found = remarks(Trial("custom_files/reward_function.py", course, statement))

    assert found[0].severity == "error"
    assert found[0].where == "custom_files/reward_function.py line 9"
    assert "log.txt (500 times" in found[0].message
    told = {remark.rule: remark for remark in found[1:]}
    assert "20 MB in a million steps" in told["prints"].message
    assert told["parameters"].remedy == "Did you mean `speed`?"
    assert "17 minutes" in told["costly"].message
    assert "2.0 s (steady driver, step 3" in told["costly-call"].message
    assert {"reads", "globals", "changes-params"} <= set(told)
