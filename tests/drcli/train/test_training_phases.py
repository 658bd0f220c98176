"""When the phases of a training with a teacher end, and who drives in them."""

import math
from dataclasses import replace

import pytest

from drcli.records.checkpoint import CheckpointName
from drcli.records.iteration import IterationRecord
from drcli.records.stage import PhaseMark
from drcli.train.training_progress import (
    MANY_ITERATIONS,
    MANY_STEPS,
    MIXED_ITERATIONS,
    MOST_STEPS,
    WINDOW,
    PhaseJudge,
    phase_of,
    teacher_drives,
)

TEACHER_WINDOW, STUDENT_WINDOW = WINDOW["teacher"], WINDOW["distillation"]
TEACHER = PhaseMark("teacher", 4, 1_000)
DISTILLATION = PhaseMark("distillation", 4, 1_000)
ANY = IterationRecord(
    iteration=4,
    checkpoint="4_Step-1000.ckpt",
    episodes=10,
    steps=100,
    total_steps=1_100,
    mean_reward=100.0,
    mean_progress=100.0,
    full_laps=10,
    best_lap_s=9.0,
    elapsed_s=1.0,
)


def driven(rewards: list[float], *, laps: int = 10) -> list[IterationRecord]:
    return [
        replace(
            ANY,
            iteration=4 + k,
            total_steps=1_000 + 100 * (k + 1),
            mean_reward=reward,
            full_laps=laps,
        )
        for k, reward in enumerate(rewards)
    ]


@pytest.mark.parametrize("reward", [100.0, -100.0, 0.0])
def test_a_teacher_that_gains_nothing_any_more_begins_to_teach(reward):
    found = PhaseJudge().next_mark(TEACHER, driven([reward] * 2 * TEACHER_WINDOW))

    assert found is not None
    assert found[0] == PhaseMark(
        "distillation", 4 + 2 * TEACHER_WINDOW, 1_000 + 200 * TEACHER_WINDOW
    )


def test_a_teacher_that_gains_goes_on():
    rewards = [100.0 + 5.0 * k for k in range(2 * TEACHER_WINDOW)]

    assert PhaseJudge().next_mark(TEACHER, driven(rewards)) is None


def test_a_teacher_that_leaves_the_road_goes_on_whatever_it_earns():
    assert PhaseJudge().next_mark(TEACHER, driven([100.0] * 2 * TEACHER_WINDOW, laps=5)) is None


def test_what_another_phase_has_driven_does_not_count():
    early = [
        replace(each, iteration=each.iteration - 2) for each in driven([1.0] * 2 * TEACHER_WINDOW)
    ]

    assert PhaseJudge().next_mark(TEACHER, early) is None


@pytest.mark.parametrize(("left_s", "ends"), [(100.0, False), (59.0, True), (math.inf, False)])
def test_a_teacher_leaves_its_student_half_of_the_time(left_s, ends):
    before = replace(ANY, iteration=3, elapsed_s=240.0)
    newest = replace(ANY, elapsed_s=300.0)
    found = PhaseJudge(None, left_s).next_mark(TEACHER, [before, newest])
    assert (found is not None) is ends


@pytest.mark.parametrize(
    ("lap_time_s", "ends"), [(10.0, True), (9.2, False), (math.inf, True), (None, False)]
)
def test_a_teacher_that_is_fast_enough_for_the_goal_begins_to_teach(lap_time_s, ends):
    found = PhaseJudge(lap_time_s).next_mark(TEACHER, driven([1.0]))

    assert (found is not None) == ends


@pytest.mark.parametrize("mark", [TEACHER, DISTILLATION])
def test_a_phase_ends_after_its_most_steps(mark):
    late = replace(ANY, total_steps=1_000 + MOST_STEPS[mark.name], full_laps=0, best_lap_s=None)

    found = PhaseJudge().next_mark(mark, [late])

    assert found is not None


def test_distillation_is_judged_by_what_the_student_drives_alone():
    mixed = driven([100.0] * (MIXED_ITERATIONS + 2 * STUDENT_WINDOW - 1))
    alone = driven([100.0] * (MIXED_ITERATIONS + 2 * STUDENT_WINDOW))

    assert PhaseJudge().next_mark(DISTILLATION, mixed) is None
    found = PhaseJudge().next_mark(DISTILLATION, alone)
    assert found is not None
    assert found[0].name == "ppo"


def test_the_last_phase_goes_on():
    mark = PhaseMark("ppo", 0, 0)

    assert PhaseJudge(99.0).next_mark(mark, driven([100.0] * 50)) is None


def test_the_student_takes_over_the_wheel_step_by_step():
    shares = [
        sum(teacher_drives(DISTILLATION, 4 + mixed, place) for place in range(20)) / 20
        for mixed in range(6)
    ]

    assert shares == [1.0, 0.75, 0.5, 0.25, 0.0, 0.0]
    assert teacher_drives(TEACHER, 99, 0)
    assert not teacher_drives(PhaseMark("ppo"), 0, 0)


def test_trainer_and_workers_agree_on_the_phase_after_a_teacher_came_or_went():
    newest = CheckpointName(7, 700)

    assert phase_of(DISTILLATION, newest, taught=True) == DISTILLATION
    assert phase_of(DISTILLATION, newest, taught=False) is None
    assert phase_of(None, newest, taught=True) == PhaseMark("teacher", 7, 700)
    assert phase_of(None, newest, taught=False) is None


@pytest.mark.parametrize(("left_s", "ends"), [(181.0, False), (179.0, True), (math.inf, False)])
def test_where_there_are_several_tracks_a_student_gets_most_of_the_time(left_s, ends):
    before = replace(ANY, iteration=3, elapsed_s=240.0)
    newest = replace(ANY, elapsed_s=300.0)

    found = PhaseJudge(None, left_s, many=True).next_mark(TEACHER, [before, newest])

    assert (found is not None) is ends


def test_a_student_of_several_tracks_goes_on_until_its_steps_or_its_time_are_over():
    level = driven([100.0] * 99)
    late = replace(ANY, total_steps=1_000 + MANY_STEPS, full_laps=0)

    assert PhaseJudge(many=True).next_mark(DISTILLATION, level) is None
    assert PhaseJudge(many=True).next_mark(DISTILLATION, [late]) is not None
    assert PhaseJudge(None, 900.0, many=True).next_mark(DISTILLATION, [late]) is None


def test_a_student_of_several_tracks_follows_its_teacher_over_many_iterations():
    """How much two of them earn depends on how long their tracks are."""
    teacher = [
        replace(each, iteration=each.iteration - 200, phase="teacher")
        for each in driven([60.0, 140.0] * MANY_ITERATIONS)
    ]
    lucky = driven([80.0] * (MIXED_ITERATIONS + MANY_ITERATIONS - 2) + [130.0] * 2)
    as_good = driven([100.0] * (MIXED_ITERATIONS + MANY_ITERATIONS))
    judge = PhaseJudge(many=True)

    assert judge.next_mark(DISTILLATION, [*teacher, *lucky]) is None
    assert judge.next_mark(DISTILLATION, [*teacher, *as_good[:-1]]) is None
    assert judge.next_mark(DISTILLATION, [*teacher, *as_good]) is not None


@pytest.mark.parametrize(
    ("steps", "spent_s", "left_s", "share"),
    [
        (0, 0.0, 100.0, 0.0),
        (MANY_STEPS // 2, 0.0, math.inf, 0.5),
        (10, 30.0, 90.0, 0.25),
        (MANY_STEPS // 2, 30.0, 90.0, 0.25),
        (10, 90.0, 0.0, 1.0),
    ],
)
def test_a_phase_is_done_by_its_steps_or_by_its_time(steps, spent_s, left_s, share):
    before = replace(ANY, iteration=3, elapsed_s=240.0)
    newest = replace(ANY, elapsed_s=240.0 + spent_s)

    done = PhaseJudge(None, left_s, many=True).done(DISTILLATION, steps, [before, newest])

    assert done == pytest.approx(share, abs=1e-4)
