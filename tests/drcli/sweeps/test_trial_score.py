"""How well a training drives at an amount of its budget, and which one is best."""

from drcli.sweeps.sweep_record import TrialRecord, TrialScore
from drcli.sweeps.trial_score import amount_of, best_of, rank, score_of, until
from iterations import iteration_record


def record(number, **changes):
    return iteration_record(
        number, **{"evaluation_progress": [], "evaluation_lap_s": [], "elapsed_s": 6.0, **changes}
    )


HISTORY = [
    record(0, elapsed_s=60.0),
    record(1, elapsed_s=120.0, evaluation_progress=[50.0, 70.0]),
    record(2, elapsed_s=180.0, evaluation_progress=[100.0, 100.0], evaluation_lap_s=[9.0, 10.0]),
    record(3, elapsed_s=240.0, evaluation_progress=[100.0, 90.0], evaluation_lap_s=[8.0]),
]


def test_the_amount_is_that_of_the_last_iteration():
    assert amount_of(HISTORY, "minutes") == 4.0
    assert amount_of(HISTORY, "steps") == 400
    assert amount_of(HISTORY, "episodes") == 16
    assert amount_of(HISTORY, "iterations") == 4
    assert amount_of([], "minutes") == 0.0


def test_trainings_are_compared_at_the_same_amount():
    assert [r.iteration for r in until(HISTORY, "minutes", 2.0)] == [0, 1]
    assert [r.iteration for r in until(HISTORY, "steps", 399)] == [0, 1, 2]
    assert [r.iteration for r in until(HISTORY, "episodes", 8)] == [0, 1]
    assert [r.iteration for r in until(HISTORY, "iterations", 99)] == [0, 1, 2, 3]
    assert [r.iteration for r in until(HISTORY, "minutes", 0.1)] == [0]


def test_a_complete_evaluation_beats_a_faster_incomplete_one():
    score = score_of(HISTORY, "lap_time")

    assert (score.checkpoint, score.laps, score.episodes, score.lap_s) == (2, 2, 2, 9.5)


def test_laps_that_a_checkpoint_drove_again_count_with_its_evaluation():
    lucky = record(
        1,
        evaluation_progress=[100.0] * 2,
        evaluation_lap_s=[7.0] * 2,
        confirmation_progress=[100.0, 20.0, 20.0, 20.0],
        confirmation_lap_s=[9.0],
    )
    score = score_of([lucky], "lap_time")

    assert (score.laps, score.episodes, score.progress, score.lap_s) == (3, 6, 60.0, 7.0)
    assert rank(score, "lap_time") < rank(score_of(HISTORY, "lap_time"), "lap_time")


def test_without_evaluations_the_training_episodes_count():
    assert score_of(HISTORY[:1], "lap_time") == TrialScore(progress=20.0, reward=1.5)
    assert score_of([], "lap_time") is None


def test_the_reward_is_averaged_over_iterations():
    lucky = [record(k, mean_reward=reward) for k, reward in enumerate([0.0, 30.0, 0.0, 6.0])]

    assert score_of(lucky, "reward").reward == 12.0


def trial(name, score):
    return TrialRecord(name, name, 0, score=score)


def test_none_is_the_best_before_one_was_evaluated_unless_rewards_count():
    trials = [trial("a", TrialScore(progress=3.0, reward=1.0)), trial("b", None)]

    assert [best_of(trials, metric) for metric in ("lap_time", "progress")] == ["", ""]
    assert best_of(trials, "reward") == "a"


def test_each_metric_has_its_own_best():
    fast = trial("fast", TrialScore(1, 2, 2, 100.0, 8.0, 10.0))
    safe = trial("safe", TrialScore(1, 2, 2, 100.0, 12.0, 30.0))
    half = trial("half", TrialScore(1, 1, 2, 99.0, 5.0, 90.0))
    none = trial("none", None)

    assert best_of([none, half, safe, fast], "lap_time") == "fast"
    assert best_of([none, half, safe, fast], "progress") == "fast"
    assert best_of([none, half, safe, fast], "reward") == "half"
    assert best_of([none], "lap_time") == ""
    assert rank(None, "reward") < rank(TrialScore(), "reward")
