"""Trainings that go wrong, as their learning curves show it (002-06, 001-44, 002-17)."""

import math
from dataclasses import replace

import pytest

from drcli.model.alarms import alarms, convergence
from iterations import iteration_record


def curve(count: int, **columns):
    """Iterations whose numbers are functions of the iteration."""
    return [
        iteration_record(n, **{name: value(n) for name, value in columns.items()})
        for n in range(count)
    ]


def subjects(records) -> list[str]:
    return [alarm.subject for alarm in alarms(records, None)]


def test_an_entropy_that_rises_is_an_alarm_and_says_from_where_to_where():
    records = curve(30, entropy=lambda n: 1.2 - 0.05 * n if n < 15 else 0.5 + 0.04 * (n - 15))

    [alarm] = alarms(records, None)

    assert alarm.subject == "entropy"
    assert alarm.text.startswith("the entropy rises, from 0.5")
    assert "`lr`" in alarm.remedy


@pytest.mark.parametrize(
    "entropy",
    [
        lambda n: 1.9 - 0.02 * n,
        lambda n: 1.0 + 0.05 * math.sin(n),
        lambda n: 0.5 if n < 27 else 1.5,  # a jump of three iterations
        lambda n: math.nan,
    ],
    ids=["falls", "wavers", "jumped just now", "unknown"],
)
def test_other_entropies_are_none(entropy):
    assert subjects(curve(30, entropy=entropy)) == []


@pytest.mark.parametrize("place", ["stage", "world"])
def test_another_stage_or_track_is_no_alarm(place):
    first = curve(20, entropy=lambda n: 0.5, mean_reward=lambda n: 100.0 if n % 2 else 40.0)
    records = [replace(record, **{place: "wide"}) for record in first]
    records += [
        iteration_record(n, entropy=0.5 + 0.1 * (n - 19), **{place: "hard"}) for n in range(20, 32)
    ]

    assert subjects(records) == []


def test_the_entropy_of_sac_is_steered_by_its_temperature():
    records = curve(30, entropy=lambda n: -1.0 + 0.1 * n, actor_loss=lambda n: 0.1)

    assert subjects(records) == []


def test_a_reward_that_jumps_up_and_down_without_growing_is_an_alarm():
    records = curve(20, mean_reward=lambda n: 100.0 if n % 2 else 40.0)

    [alarm] = alarms(records, None)

    assert alarm.subject == "reward"
    assert "83 %" in alarm.text


@pytest.mark.parametrize(
    "reward",
    [
        lambda n: 10.0 * n,
        lambda n: 50.0 + (8.0 if n % 2 else -8.0),
        lambda n: (20.0 * n) + (30.0 if n % 2 else -30.0),
        lambda n: 0.0,
    ],
    ids=["grows", "wavers as usual", "grows in jumps", "nothing"],
)
def test_other_rewards_are_none(reward):
    assert subjects(curve(20, mean_reward=reward)) == []


@pytest.mark.parametrize(
    ("per_m", "progress", "expected"),
    [(3.0, 90.0, ["steering"]), (1.6, 90.0, []), (3.0, 20.0, []), (None, 90.0, [])],
)
def test_a_car_that_gets_around_in_zigzag_is_an_alarm(per_m, progress, expected):
    records = curve(
        12,
        evaluation_progress=lambda n: [progress] if n % 2 else [],
        evaluation_steering_per_m=lambda n: per_m if n % 2 else None,
    )

    assert subjects(records) == expected


def test_a_collapse_comes_first_and_names_the_way_back():
    records = curve(
        20,
        mean_progress=lambda n: 80.0 if n < 10 else 10.0,
        mean_reward=lambda n: 100.0 if n % 2 else 40.0,
    )

    assert subjects(records) == ["collapse", "reward"]
    assert "DR_TRAIN_MAX_ROLLBACKS" in alarms(records, None)[0].remedy


@pytest.mark.parametrize(
    ("training", "evaluation", "reached"),
    [(97.0, 99.0, True), (60.0, 100.0, False), (30.0, 31.0, False)],
)
def test_a_training_has_converged_when_it_meets_its_evaluations(training, evaluation, reached):
    records = curve(  # 002-05
        10,
        mean_progress=lambda n: training,
        evaluation_progress=lambda n: [evaluation] if n else [],
    )

    found = convergence(records)

    assert found.gap == pytest.approx(evaluation - training)
    assert found.reached is reached
    assert convergence(records[:4]) is None


def test_a_student_that_takes_over_from_its_teacher_is_no_collapse():
    drives = [95.0] * 6 + [95.0, 75.0, 50.0, 30.0, 20.0, 25.0, 30.0]
    records = [
        iteration_record(n, mean_progress=p, phase="teacher" if n < 6 else "distillation")
        for n, p in enumerate(drives)
    ]
    alone = [replace(record, phase="") for record in records]

    assert subjects(alone) == ["collapse"]
    assert subjects(records) == []


def test_the_hyperparameters_of_the_file_are_not_blamed_for_a_teacher():
    rising = {"entropy": lambda n: 1.2 - 0.05 * n if n < 15 else 0.5 + 0.04 * (n - 15)}

    assert subjects(curve(30, **rising, phase=lambda _: "ppo")) == ["entropy"]
    assert subjects(curve(30, **rising, phase=lambda _: "teacher")) == []
