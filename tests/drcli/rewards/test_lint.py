"""Which rewards are said to have loopholes, and how findings are put into words."""

import runpy
from dataclasses import replace
from pathlib import Path

import pytest

from drcli.rewards.check import report_of
from drcli.rewards.sandbox.run_sandbox import (
    CallIndex,
    Difference,
    Effect,
    Failure,
    Printed,
    SandboxResult,
    Timing,
)

CALLS = 1_000
DISCOUNT = 0.99
DEFAULTS = Path(__file__).resolve().parents[3] / "defaults"


def on_the_road(params):
    return params["all_wheels_on_track"] and not params["is_offtrack"]


@pytest.fixture
def rules(tried_of):
    def of(function) -> list[str]:
        return [problem.rule for problem in report_of([tried_of(function)], DISCOUNT).warnings]

    return of


def test_a_constant_reward_is_told_and_nothing_follows_from_it(rules):
    assert rules(lambda params: 1.0) == ["constant"]


def test_pay_for_speed_alone_cancels_out_unless_later_steps_count_less(tried_of):
    tried = tried_of(lambda params: params["speed"] if on_the_road(params) else 0.0)
    whole, discounted = report_of([tried], 1.0), report_of([tried], DISCOUNT)

    assert [problem.rule for problem in whole.warnings] == ["cancels-out"]
    assert "12.1 s" in whole.warnings[0].message
    assert discounted.warnings == []
    [note] = discounted.notes
    assert note.rule == "cancels-out"
    assert "discount_factor 0.99" in note.message


def test_a_slow_lap_that_earns_more_is_told_only_if_it_does_so_from_the_start_too(tried_of):
    def nearly_as_the_pace(params):
        return on_the_road(params) * params["speed"] ** 0.7

    tried = tried_of(nearly_as_the_pace)
    whole, discounted = report_of([tried], 1.0), report_of([tried], DISCOUNT)

    assert [problem.rule for problem in whole.warnings] == ["slow-lap"]
    assert discounted.warnings == discounted.notes == []


def test_a_hang_in_the_samples_leaves_no_place_on_the_drive(with_result, course, values):
    timing = Timing(1e-6, 1e-6, 1e-6, CallIndex(len(course.course.sequences), 3))

    report = report_of([with_result(SandboxResult(values=values, timing=timing))], 1.0)

    assert report.time is not None
    assert report.time.worst_place == "one of the calls before the drive"


def test_several_races_have_one_remark_on_the_sum_of_a_lap(tried_of):
    tried = [
        tried_of(lambda params, power=power: on_the_road(params) * (0.1 + params["speed"] ** power))
        for power in (0.0, 0.1, 1.0)
    ]

    report = report_of(tried, 1.0)

    assert [problem.rule for problem in report.warnings] == ["standing"]


def test_a_reward_that_only_samples_earn_is_not_called_constant(with_result, course):
    driven = [[1e-3] * len(calls) for calls in course.course.sequences]
    told = [
        report_of([with_result(SandboxResult(values=[*driven, samples]))], DISCOUNT).warnings
        for samples in ([1e-3] * 9, [1.0] + [1e-3] * 8)
    ]

    assert [[problem.rule for problem in found][:1] for found in told] == [
        ["constant"],
        ["off-track"],
    ]


def test_pay_by_the_step_is_more_for_a_slow_lap(rules):
    assert rules(lambda params: 0.1 + params["speed"] ** 0.1 * on_the_road(params)) == ["slow-lap"]


def test_pay_for_standing_is_told(rules):
    found = rules(lambda params: 1.0 if on_the_road(params) else 0.0)

    assert found == ["standing"]


def test_a_car_off_the_road_that_is_paid_as_before_is_told(rules):
    assert rules(lambda params: params["speed"] ** 2) == ["off-track"]


def test_a_random_reward_is_not_said_to_pay_a_car_off_the_road(tried_of):
    tried = tried_of(lambda params: params["speed"] ** 2)
    differs = Difference(CallIndex(0, 1), 1.0, 2.0, times=9, of=9)

    report = report_of([replace(tried, result=replace(tried.result, random=differs))], DISCOUNT)

    assert [problem.rule for problem in report.warnings] == ["random"]


def test_pay_for_fast_cars_only_says_nothing_of_the_places_of_a_slower_one(rules):
    assert "off-track" not in rules(
        lambda params: 1.0 if params["speed"] > 2.0 and on_the_road(params) else 1e-5
    )


def test_a_driver_that_left_the_road_tells_nothing_of_laps(tried_of):
    """Few actions, or fast ones only, cannot follow the centre line."""
    tried = tried_of(lambda params: -1.0 - params["distance_from_center"])
    trips = [
        replace(trip, calls=[{**trip.calls[0], "is_offtrack": True}, *trip.calls[1:]])
        for trip in tried.course.trips
    ]
    left = replace(tried, course=replace(tried.course, trips=trips))

    assert tried.prefers_fast is not None
    assert left.prefers_fast is None
    assert report_of([left], DISCOUNT).warnings == []


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
def values(course):
    """Rewards without a loophole that anything is said about."""
    return [[float(k % 7) for k in range(len(calls))] for calls in course.course.sequences]


@pytest.fixture
def told(with_result, course, values):
    """What is said about a result, by rule."""

    def of(*, text: str = "", **found):
        result = SandboxResult(values=values, **{"calls": CALLS, **found})
        report = report_of([with_result(result, text)], DISCOUNT)
        return {problem.rule: problem for problem in (*report.errors, *report.warnings)}

    return of


@pytest.mark.parametrize(
    ("module", "remedy"),
    [
        ("no_such.geometry", "as with `pip install no_such`, or do without"),
        ("line", "Put what you need of line into mine.py"),
        ("reward_function", "Remove the import"),
    ],
)
def test_a_module_that_cannot_be_imported_has_a_remedy(told, tmp_path, monkeypatch, module, remedy):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "line.py").write_text("POINTS = []\n")
    failure = Failure("load", "It fails.", line=1, missing=module)

    assert remedy in told(failures=[failure])["V-02"].remedy


@pytest.mark.parametrize(
    "asks",
    ["params['distance_from_centre']", "params.get('distance_from_centre', 0)"],
)
def test_a_name_that_is_not_a_parameter_is_told_with_its_line(told, asks):
    text = (
        f"def reward_function(params):\n    params['own'] = 1\n    return params['own'] + {asks}\n"
    )

    problem = told(text=text)["V-22"]

    assert problem.where == "mine.py line 3"
    assert problem.remedy == "Did you mean `distance_from_center`?"


@pytest.mark.parametrize("looks", ["'fog' in params", "'fog' not in params.keys()"])
def test_a_name_that_the_file_looks_for_first_is_not_told(told, looks):
    text = f"def reward_function(params):\n    return params['fog'] if {looks} else params['x']\n"

    assert "V-22" not in told(text=text)


def test_names_of_other_dictionaries_are_not_told(told):
    text = "START = {}\ndef reward_function(params):\n    return START['begun'] + params['x']\n"

    assert "V-22" not in told(text=text)


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
    place = CallIndex(sequence=0, index=1)
    found = Difference(place=place, value=value, other=other, times=1, of=9)

    assert f"{shown[0]} {word} {shown[1]} (" in told(**{rule: found})[rule].message


def test_effects_and_habits_are_put_into_words(with_result, course, values):
    result = SandboxResult(
        values=values,
        calls=CALLS,
        counted=100,
        effects=[
            Effect(kind="reads", what="line.npy", line=3, times=1),
            Effect(kind="writes", what="log.txt", line=9, times=CALLS),
        ],
        printed=Printed(lines=100, characters=2_000, line=7),
        timing=Timing(
            median_s=1e-3, mean_s=2e-3, worst_s=2.0, worst=CallIndex(sequence=0, index=1)
        ),
    )

    found = with_result(result, name="custom_files/reward_function.py").problems

    assert {problem.severity for problem in found} == {"warning"}
    assert [(problem.rule, problem.line) for problem in found] == [
        ("V-25", 9),
        ("V-25", 3),
        ("V-25", 7),
        ("V-26", None),
        ("V-26", None),
    ]
    writes, reads, prints, slow, slow_call = (problem.message for problem in found)
    assert writes == "It writes or removes files in every call: log.txt."
    assert reads == "It reads files: line.npy."
    assert "20 MB in a million steps" in prints
    assert "17 minutes" in slow
    assert "One call takes 2.0 s" in slow_call
