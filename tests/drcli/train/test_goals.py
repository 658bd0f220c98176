"""When a training ends, and how a collapsed one is told."""

from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType

import pytest

from drcli.config.loading import load_settings
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.history import collapse
from drcli.records.iteration import IterationRecord
from drcli.records.job import Job
from drcli.train import goals as table
from drcli.train.episode_share import EvaluationBudget
from drcli.train.goals import Goal, Goals, Target, ending, mean_score
from iterations import iteration_record


def record(iteration: int = 0, **changes) -> IterationRecord:
    plain = {"episodes": 20, "total_steps": 100, "mean_reward": 10.0, "mean_progress": 50.0}
    return iteration_record(iteration, **{**plain, **changes})


@pytest.fixture
def goals(tmp_path):
    def make(
        *lines: str,
        until_laps=None,
        lap_time_s=None,
        asked=MappingProxyType({}),
        max_minutes=None,
        clock=lambda: 0.0,
        before_s=0.0,
        now=lambda: 0.0,
        job_changes=MappingProxyType({}),
        **parameters,
    ):
        (tmp_path / "run.env").write_text("\n".join(lines))
        (tmp_path / "system.env").write_text("")
        wanted = {"until_laps": until_laps, "until_lap_time_s": lap_time_s, **asked}
        job = Job(
            config=load_settings(tmp_path, environ={}).run,
            session="s",
            seed=1,
            max_minutes=max_minutes,
            folder=Path(),
            launcher_pid=1,
            goals={key: each for key, each in wanted.items() if each is not None},
            **job_changes,
        )
        return Goals(job, Hyperparameters(**parameters), clock, before_s=before_s, now=now)

    return make


def test_a_training_without_goals_goes_on(goals):
    assert goals().reached([record(k) for k in range(50)]) is None


def test_the_time_of_this_start_counts(goals):
    times = iter([1_000.0, 1_059.0, 1_061.0])
    limited = goals(max_minutes=1.0, clock=lambda: next(times))

    assert limited.reached([]) is None
    assert limited.reached([]) == "Training is complete: the time limit (1 minute) was reached."


def test_the_files_that_everybody_has_train_as_long_as_they_did_elsewhere(goals):
    limited = goals(term_cond_max_episodes=1000, term_cond_avg_score=350)
    records = [record(k, episodes=20, mean_reward=400.0) for k in range(1000)]

    assert limited.reached(records[:999]) is None
    assert limited.reached(records) == (
        "Training is complete: 1000 iterations are done, term_cond_max_episodes is 1000."
    )


def test_iterations_can_be_limited(goals):
    limited = goals("DR_TRAIN_MAX_ITERATIONS=3")

    assert limited.reached([record(0), record(1)]) is None
    assert "3 iterations are done" in limited.reached([record(k) for k in range(3)])


def test_the_mean_score_is_that_of_the_last_hundred_episodes():
    records = [record(0, episodes=90, mean_reward=0.0), record(1, episodes=40, mean_reward=8.0)]

    assert mean_score(records) == pytest.approx((40 * 8.0 + 60 * 0.0) / 100)
    assert mean_score(records[1:]) is None


def test_a_mean_reward_can_end_the_training(goals):
    limited = goals("DR_TRAIN_STOP_MEAN_SCORE=350")
    good = [record(k, mean_reward=351.0) for k in range(5)]

    assert limited.reached(good[:4]) is None
    assert "DR_TRAIN_STOP_MEAN_SCORE is 350" in limited.reached(good)


def driven(iteration: int, *lap_s: float, of: int = 0, again: Sequence[float] = (), **changes):
    """A checkpoint that completed these laps of its evaluation, and then those laps of 40."""
    missing, missing_again = max(0, of - len(lap_s)), 40 - len(again)
    if again:
        changes["confirmation_progress"] = [100.0] * len(again) + [50.0] * missing_again
        changes["confirmation_lap_s"] = list(again)
    progress = [100.0] * len(lap_s) + [90.0] * missing
    return record(iteration, evaluation_progress=progress, evaluation_lap_s=list(lap_s), **changes)


def test_laps_are_reached_when_a_checkpoint_completes_them_all_and_38_of_40_others(goals):
    limited = goals(until_laps=3)
    laps = [12.0] * 4

    assert limited.reached([driven(1, *laps)]) is None  # it has not driven again yet
    assert limited.reached([driven(1, *laps, of=5, again=[12.0] * 40)]) is None
    assert limited.reached([driven(1, *laps[:2], again=[12.0] * 40)]) is None
    assert limited.reached([driven(1, *laps, again=[12.0] * 37)]) is None
    assert limited.reached([driven(1, *laps, again=[11.0, *[12.0] * 37]), record(2)]) == (
        "Training is complete: checkpoint 1 drove 38 of 40 laps clean, median 12.00 s, slowest "
        "12.00 s, from starts that it had not driven before (--until-laps 3)."
    )


@pytest.mark.parametrize(("until_laps", "laps"), [(None, 5), (3, 3), (8, 8)])
def test_a_lap_time_is_reached_when_all_laps_and_38_of_40_others_are_fast_enough(
    goals, until_laps, laps
):
    limited = goals(until_laps=until_laps, lap_time_s=8.0)

    def after(*times: float, again: Sequence[float] = [7.0] * 40) -> str | None:
        return limited.reached([driven(0, *times, again=again)])

    assert after(*[7.0] * (laps - 1)) is None
    assert after(*[7.0] * (laps - 1), 8.1) is None
    assert after(*[7.0] * (laps - 1), 8.0, again=[7.0] * 37 + [8.1]) is None
    assert "38 of 40 laps clean, median 7.00 s, slowest 8.00 s, from starts" in after(
        *[7.0] * (laps - 1), 8.0, again=[7.0] * 37 + [8.0]
    )
    assert "39 of 40 laps clean, median 7.00 s, slowest 8.10 s, 38 of them in 8 s or less" in after(
        *[7.0] * laps, again=[7.0] * 38 + [8.1]
    )


def test_progress_must_be_held_for_some_evaluations_in_a_row_and_on_40_other_laps(goals):
    limited = goals("DR_TRAIN_STOP_PROGRESS=95", "DR_TRAIN_STOP_EVALUATIONS=2")
    good, bad = [100.0, 94.0], [100.0, 80.0]

    def after(*evaluations, again: float = 95.0):
        again_ = {"confirmation_progress": [again] * 40}
        return limited.reached(
            [record(k, evaluation_progress=list(e), **again_) for k, e in enumerate(evaluations)]
        )

    assert after(good) is None
    assert after(good, bad, good) is None
    assert after(bad, good, [], good, again=94.0) is None
    assert after(bad, good, [], good) == (
        "Training is complete: checkpoint 3 drove 0 of 40 laps clean, 95.0 % of the lap on "
        "average, from starts that it had not driven before (DR_TRAIN_STOP_PROGRESS=95)."
    )


def test_a_collapse_is_told_with_the_checkpoint_to_go_back_to():
    progress = [20.0, 60.0, 97.0, 98.0, 99.0, 70.0, 30.0, 23.0]
    records = [record(k, mean_progress=p) for k, p in enumerate(progress)]

    assert collapse(records[:5], "4_Step-9.ckpt") is None
    assert collapse(records, "4_Step-9.ckpt") == "completion fell from 98 % to 41 %; best is 4"
    assert collapse(records, None) == "completion fell from 98 % to 41 %"


def test_a_training_that_never_got_far_has_nothing_to_lose():
    records = [record(k, mean_progress=p) for k, p in enumerate([30.0, 30.0, 30.0, 5.0, 5.0, 5.0])]

    assert collapse(records, None) is None


def test_evaluations_take_no_more_than_their_share_of_the_time():
    now = [0.0]
    budget = EvaluationBudget(0.1, clock=lambda: now[0])
    spent = evaluated = 0.0

    for _ in range(200):
        now[0] += 1.0
        if budget.allows_another():
            evaluated += 1
            now[0] += 0.5
            spent += 0.5
            budget.spend(0.5)

    assert spent / now[0] == pytest.approx(0.1, abs=0.01)
    assert evaluated > 30


def test_a_credit_allows_evaluations_before_there_is_a_share_of_much_time():
    budget = EvaluationBudget(0.1, 5.0, clock=lambda: 0.0)
    evaluated = 0

    while budget.allows_another():
        evaluated += 1
        budget.spend(2.0)

    assert evaluated == 2


@pytest.mark.parametrize(("share", "promising"), [(0.0, True), (1.0, False)])
def test_the_last_drive_within_the_time_evaluates_in_any_case(share, promising):
    now = [0.0]
    budget = EvaluationBudget(share, clock=lambda: now[0])
    budget.spend(3.0)

    asked = []
    for now[0] in (10.0, 20.0, 30.0, 40.0, 50.0):
        asked.append(budget.allows_another(55.0 - now[0], promising=promising))

    assert asked == [False, False, False, True, False]


def test_the_time_of_all_starts_counts_where_any_machine_may_continue(goals):
    def limited(*, whole_run):
        times = iter([0.0, 601.0])
        return goals(
            max_minutes=60.0,
            clock=lambda: next(times),
            job_changes={"whole_run": whole_run},
            before_s=3000.0,
        )

    assert limited(whole_run=False).reached([]) is None
    assert "the time limit (60 minutes)" in limited(whole_run=True).reached([])


def test_a_training_lives_for_so_long_after_its_first_start(goals):
    times = iter([0.0, 0.0, 90.0, 110.0])
    limited = goals(
        "DR_TIME_TO_LIVE_MINUTES=30",
        clock=lambda: next(times),
        job_changes={"ends_at": 1_000_100.0},
        now=lambda: 1_000_000.0,
    )

    assert limited.reached([]) is None
    assert limited.reached([]) == (
        "Training is complete: 30 minutes have passed since its first start."
    )


def test_episodes_can_be_limited(goals):  # 000-13
    limited = goals("DR_TRAIN_MAX_EPISODES=50")
    records = [record(k, episodes=20) for k in range(3)]

    assert limited.reached(records[:2]) is None
    assert limited.reached(records) == (
        "Training is complete: 60 training episodes are done, DR_TRAIN_MAX_EPISODES is 50."
    )
    assert limited.reached(records[:1], episodes=50) is not None


def test_steps_can_be_limited(goals):
    limited = goals("DR_TRAIN_MAX_STEPS=2500")
    records = [record(k, total_steps=1000 * (k + 1)) for k in range(3)]

    assert limited.reached(records[:2]) is None
    assert limited.reached(records) == (
        "Training is complete: 3,000 steps are learned from, DR_TRAIN_MAX_STEPS is 2,500."
    )


def test_the_mean_score_is_taken_over_so_many_episodes_as_are_wanted(goals):  # 000-12
    limited = goals("DR_TRAIN_STOP_MEAN_SCORE=300", "DR_TRAIN_STOP_SCORE_EPISODES=40")
    records = [record(0, mean_reward=0.0), *(record(k, mean_reward=300.0) for k in (1, 2))]

    assert limited.reached(records[:2]) is None
    assert "of the last 40 episodes is 300.0" in limited.reached(records)


def test_a_mean_lap_time_ends_the_training_once_every_lap_is_complete(goals):
    limited = goals("DR_TRAIN_STOP_LAP_TIME=12")

    def after(*times: float, of: int = 0, again: float = 12.0) -> str | None:
        return limited.reached([driven(0, *times, of=of, again=[again] * 38)])

    assert after(9.0, of=2) is None
    assert after(11.0, 14.0) is None
    assert after(11.0, 12.0, again=12.1) is None
    assert "slowest 12.00 s, 12.00 s on average, from starts" in after(11.0, 13.0)


def test_a_worse_evaluation_that_arrives_later_does_not_hide_the_goal(goals):
    limited = goals(until_laps=1)
    worse = driven(2, 12.0, of=2)

    assert limited.reached([driven(1, 12.0, again=[12.0] * 40), worse]) is not None
    assert limited.reached([worse]) is None


def test_how_well_the_car_drives_is_judged_by_the_last_stage_only(goals):
    limited = goals("DR_TRAIN_STOP_PROGRESS=50", "DR_TRAIN_STOP_EVALUATIONS=1", until_laps=1)
    good = driven(0, 9.0, again=[9.0] * 40)

    assert limited.reached([good], judged=()) is None
    assert limited.reached([good], judged=[good]) is not None


def test_a_new_stage_is_no_collapse():
    wide = [record(k, mean_progress=98.0, stage="wide") for k in range(4)]
    hard = [record(k, mean_progress=10.0, stage="hard") for k in range(4, 8)]

    assert collapse([*wide, *hard], None) is None
    assert collapse([*wide, *(record(k, mean_progress=9.0, stage="wide") for k in (4, 5, 6))], None)


def test_what_a_teacher_drives_reaches_no_mean_reward(goals):
    watched = goals("DR_TRAIN_STOP_MEAN_SCORE=9", "DR_TRAIN_STOP_SCORE_EPISODES=40")
    phases = ("teacher", "teacher", "distillation", "distillation")
    taught = [record(k, phase=phase) for k, phase in enumerate(phases)]
    own = [record(k, phase="ppo") for k in (4, 5)]

    assert watched.reached(taught) is None
    assert watched.reached([*taught, own[0]]) is None
    assert "the mean reward of the last 40 episodes is 10.0" in watched.reached([*taught, *own])


def test_a_row_of_the_table_is_all_that_a_goal_needs(goals, monkeypatch):
    share = Goal(
        "--until-progress",
        lambda job: job.goals.get("until_progress"),
        lambda job, least: f"at {least:g} % in one evaluation",
        target=lambda name, job, least: Target(name, progress=least),
    )
    monkeypatch.setattr(table, "GOALS", (*table.GOALS, share))
    limited = goals(asked={"until_progress": 90.0})

    job = limited._job
    assert "at 90 % in one evaluation (--until-progress)" in ending(job, Hyperparameters())
    assert limited.reached([driven(0, *[8.0] * 4, of=9, again=[8.0] * 40)]) is not None
    assert limited.reached([driven(0, *[8.0] * 4, of=9, again=[8.0] * 31)]) is None
