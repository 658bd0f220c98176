"""The model of a training with many workers keeps to what can be worked out by hand."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "bench"))
from scale_model import Costs, Setup, Station, predicted

FREE = Costs(step_s=0.01, episode_steps=100.0)
QUICK = Setup(episodes=80, look_s=1e-9, look_share=0.0, members_s=1e9, renew_s=1e8)


@pytest.fixture(autouse=True)
def _no_pause(monkeypatch):
    """Looks with short pauses, so that nearly only the work takes time."""
    monkeypatch.setattr("scale_model.Model._pause", lambda *_: 0.1)


@pytest.mark.parametrize("workers", [1, 2, 4, 8])
def test_without_latency_and_learning_n_workers_are_n_times_as_fast(workers):
    found = predicted(FREE, replace(QUICK, workers=workers))

    assert found.iterations_per_s == pytest.approx(workers / 80.0, rel=0.02)
    assert found.steps_per_s == pytest.approx(workers * 100.0, rel=0.02)
    assert found.worker_idle == pytest.approx(0.0, abs=0.02)


def test_driving_and_learning_take_turns_without_overlap():
    costs = replace(FREE, learn_step_s=0.01)

    found = predicted(costs, replace(QUICK, workers=1))

    assert found.iterations_per_s == pytest.approx(1 / 160.0, rel=0.01)
    assert found.learner_idle == pytest.approx(0.5, abs=0.01)


def test_driving_and_learning_overlap_with_a_lag_of_one():
    costs = replace(FREE, learn_step_s=0.01)

    found = predicted(costs, replace(QUICK, workers=1, ahead=1))

    assert found.iterations_per_s == pytest.approx(1 / 80.0, rel=0.02)
    assert found.learner_idle < 0.02


def test_more_workers_than_episodes_bring_nothing():
    few = predicted(FREE, replace(QUICK, workers=80))
    many = predicted(FREE, replace(QUICK, workers=400))

    assert many.iterations_per_s == pytest.approx(few.iterations_per_s, rel=0.01)


def test_every_round_trip_of_the_way_counts():
    costs = replace(FREE, round_trip_s=0.1, worker_gets=3, worker_puts=4, trainer_puts=3)

    found = predicted(costs, replace(QUICK, workers=1))

    # noticed, 3 and the weights; 4 written; listed, manifest or part, 3 published
    expected = 80.0 + 0.1 * (1 + 4 + 4 + 1 + 1 + 3)
    assert 1.0 / found.iterations_per_s == pytest.approx(expected, abs=0.3)


def test_requests_are_counted():
    setup = replace(QUICK, workers=4)

    found = predicted(FREE, setup, iterations=10)

    written = 4 * FREE.worker_puts + FREE.trainer_puts + 1
    assert found.requests["put"] / 10 == pytest.approx(written, rel=0.1)


def test_a_bucket_that_is_full_limits_the_rate():
    costs = replace(FREE, step_s=1e-6, gets_per_s=100.0)

    found = predicted(costs, replace(QUICK, workers=40))

    assert (found.requests["get"]) / found.seconds == pytest.approx(100.0, rel=0.1)


def test_the_network_of_the_trainer_limits_the_steps():
    costs = replace(FREE, step_s=1e-6, step_bytes=10_000.0, trainer_bytes_per_s=1e6)

    found = predicted(costs, replace(QUICK, workers=8))

    assert found.steps_per_s == pytest.approx(100.0, rel=0.05)


def test_equal_seeds_give_equal_results_and_others_do_not():
    costs = replace(FREE, spread=0.2)
    setup = replace(QUICK, workers=8)

    assert predicted(costs, setup, seed=3) == predicted(costs, setup, seed=3)
    assert predicted(costs, setup, seed=3) != predicted(costs, setup, seed=4)


def test_a_station_serves_in_order():
    station = Station(2)

    assert [station.serve(0.0, 1.0) for _ in range(4)] == [1.0, 1.0, 2.0, 2.0]
    assert station.serve(10.0, 1.0) == 11.0


def test_an_iteration_waits_for_its_slowest_worker_unless_others_may_drive_ahead():
    costs = replace(FREE, episode_spread=0.5)
    setup = replace(QUICK, workers=8)
    speeds = {
        ahead: predicted(costs, replace(setup, ahead=ahead), iterations=200).steps_per_s
        for ahead in (0, 1, 2, 8)
    }

    # Ten episodes take 1 +- 0.158 of the mean, and the longest of eight 1.42 deviations more.
    assert speeds[0] / 800.0 == pytest.approx(1.0 / 1.225, abs=0.02)
    assert speeds[0] < speeds[1] < speeds[2]
    assert speeds[8] > 0.97 * 800.0


def test_workers_are_never_further_ahead_than_they_may_be():
    costs = replace(FREE, episode_spread=0.5, learn_step_s=0.01)

    found = predicted(costs, replace(QUICK, workers=8, ahead=3), iterations=50)

    assert max(found.lags) == 3
    assert found.learner_idle < 0.02  # it is eight times too slow for them


def test_a_worker_fetches_weights_only_once():
    costs = replace(FREE, weights_bytes=1e6, learn_step_s=0.001)
    setup = replace(QUICK, workers=4, ahead=4)

    found = predicted(costs, setup, iterations=20)

    assert found.received_bytes <= 1.1 * 4 * 20 * 1e6
