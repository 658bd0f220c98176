"""Which checkpoints a simulation worker evaluates, by the way that the training shall end."""

from dataclasses import replace

import pytest

from drcli.store.history import read_history
from drcli.workers import sim
from training_in_memory import PREFIX, TrainingInMemory

ITERATIONS = 4


@pytest.mark.parametrize(
    ("options", "first_lap", "evaluated"),
    [
        ({}, None, [0]),
        ({"until_laps": 1}, None, [0, 1, 2, 3]),
        ({"until_lap_time_s": 3.0}, None, [0]),
        ({"until_lap_time_s": 3.0}, 1, [0, 2, 3]),
        ({"until_lap_time_s": 3.0, "until_laps": 2}, 0, [0, 1, 2, 3]),
    ],
)
def test_fast_laps_are_looked_for_from_the_first_training_lap_on(
    working_folder, monkeypatch, options, first_lap, evaluated
):
    training = TrainingInMemory(working_folder, monkeypatch, DR_TRAIN_MAX_ITERATIONS=ITERATIONS)
    share = iter([True])
    monkeypatch.setattr(sim.EvaluationBudget, "allows_another", lambda self: next(share, False))
    told = sim.log_training

    def with_a_lap(episode, iteration, worker):
        if iteration == first_lap:
            episode.rows[-1] = replace(episode.rows[-1], status="lap_complete")
        told(episode, iteration, worker)

    monkeypatch.setattr(sim, "log_training", with_a_lap)

    training.train(**options)

    history = read_history(training.bucket, PREFIX)
    assert len(history) == ITERATIONS
    assert [r.iteration for r in history if r.evaluation_progress] == evaluated
