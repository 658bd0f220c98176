"""What a trainer and a simulation send to the tools of others."""

import math

import pytest

from drcli.learn.update_result import PPOStats
from drcli.metrics import figure_events
from drcli.metrics.figure_events import Ended, EpochPoint, Point
from drcli.records.episode_metrics import EpisodeMetrics, TrialMetrics
from drcli.records.iteration import IterationRecord
from drcli.train import learner_metrics
from drcli.train.learner_metrics import LiveFigures, row_of

STATS = PPOStats(0, 3e-4, 0.1, 0.2, 1.25, 0.01, 0.05, 0.9)


def record(iteration, **changes):
    values = {
        "iteration": iteration,
        "checkpoint": f"{iteration}_Step-{100 * iteration}.ckpt",
        "episodes": 5,
        "steps": 100,
        "total_steps": 100 * (iteration + 1),
        "mean_reward": 7.0,
        "mean_progress": 55.5,
        "full_laps": 1,
        "best_lap_s": 12.5,
        "elapsed_s": 30.0 * (iteration + 1),
        **changes,
    }
    return IterationRecord(**values)


class Sender:
    """Keeps what is sent."""

    def __init__(self):
        self.got, self.closed = [], False

    def send(self, *events):
        self.got += events

    def close(self):
        self.closed = True


def test_an_iteration_has_cleanrls_names_and_its_steps():
    sender, one = Sender(), record(0)
    figures = LiveFigures(sender)

    figures.epoch(STATS)
    figures.learned(row_of(one, STATS), [one])

    epoch, point = sender.got
    assert isinstance(epoch, EpochPoint)
    assert epoch.entropy == 1.25
    assert point.step == 100
    assert point.values["charts/episodic_return"] == 7.0
    assert point.values["losses/approx_kl"] == 0.01
    assert point.values["charts/episodic_progress"] == 55.5
    assert "global_step" not in point.values
    assert all(math.isfinite(value) for value in point.values.values())


def test_each_evaluation_is_sent_once_at_the_steps_of_its_checkpoint():
    sender = Sender()
    before = record(0, evaluation_progress=[10.0])
    figures = LiveFigures(sender, [before])
    scored = record(1, evaluation_progress=[50.0, 100.0], evaluation_lap_s=[14.5])

    figures.learned(row_of(record(1)), [before, record(1)])
    figures.learned(row_of(record(2)), [before, scored, record(2)])
    figures.end([before, scored, record(2)], finished=True)

    assert [event.step for event in sender.got if isinstance(event, Point)] == [200, 300, 100]
    evaluation = sender.got[-2]
    assert evaluation.is_evaluation
    assert evaluation.values == {
        "evaluation/progress": 75.0,
        "evaluation/laps": 1.0,
        "evaluation/clean_share": 0.5,
        "evaluation/median_lap_s": 14.5,
        "evaluation/best_lap_s": 14.5,
        "evaluation/mean_lap_s": 14.5,
    }
    assert isinstance(sender.got[-1], Ended)
    assert sender.closed


def test_an_entropy_that_is_no_number_is_not_sent():
    sender = Sender()

    LiveFigures(sender).epoch(PPOStats(0, 3e-4, 0.1, 0.2, math.nan, 0.01, 0.05, 0.9))

    assert sender.got == []


def test_earlier_iterations_keep_their_distances_in_time():
    second = {"second_world": "oval", "second_progress": [40.0], "second_lap_s": []}
    records = [record(0), record(1, evaluation_progress=[20.0], **second)]

    first, later, evaluation = learner_metrics.earlier_points(records)

    assert later.time_s - first.time_s == pytest.approx(30.0)
    assert evaluation.values["evaluation_second/progress"] == 40.0
    assert evaluation.step == 100
    assert learner_metrics.earlier_points([]) == []


def metrics(phase="training"):
    return EpisodeMetrics(17, 9000, 5000, 4000, 3, 3, phase, 63, "Off track", iteration=0)


def test_episodes_that_ended_together_get_times_of_their_own():
    episodes = [metrics()] * 4

    points = figure_events.episode_points(episodes, 2, (100.0, 110.0))
    quick = figure_events.episode_points(episodes, 2, (100.0, 102.0))

    assert [point.time_s for point in points] == [107.0, 108.0, 109.0, 110.0]
    assert [point.time_s for point in quick] == [100.5, 101.0, 101.5, 102.0]
    assert {(p.worker, p.reward, p.progress, p.elapsed_ms) for p in points} == {(2, 17, 63, 4000)}
    assert figure_events.episode_points([], 0, (1.0, 2.0)) == []


def test_a_trial_has_its_resets():
    trial = TrialMetrics(100, 14000, 0, 14000, "Lap complete", 1, 0, 2, 0, 3, 1)

    [point] = figure_events.trial_points([trial], (0.0, 20.0))

    assert (point.resets, point.status, point.elapsed_ms) == (3, "Lap complete", 14000)
