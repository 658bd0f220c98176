import json
import math
from dataclasses import replace

import pytest

from drcli.store.history import History, IterationRecord, fields_of, read_history
from drcli.store.memory_bucket import MemoryBucket


def record(iteration: int) -> IterationRecord:
    return IterationRecord(
        iteration=iteration,
        checkpoint=f"{iteration}_Step-{100 * iteration}.ckpt",
        episodes=4,
        steps=100,
        total_steps=100 * (iteration + 1),
        mean_reward=1.5,
        mean_progress=20.0,
        full_laps=0,
        best_lap_s=None,
        entropy=1.0,
        surrogate_loss=0.1,
        value_loss=0.2,
        kl=0.01,
        steps_per_s=500.0,
        real_time_factor=30.0,
        drive_s=0.3,
        learn_s=0.4,
        exchange_s=0.1,
        elapsed_s=float(iteration),
    )


@pytest.fixture
def history() -> History:
    history = History(MemoryBucket(), "model")
    for iteration in range(3):
        history.add(record(iteration))
    return history


def test_iterations_that_will_be_repeated_are_forgotten(history):
    history.restore(2, fields_of(record(1)))

    assert [r.iteration for r in history.records] == [0, 1]


def test_a_record_that_died_with_its_trainer_comes_back_with_the_checkpoint(history):
    history.restore(4, fields_of(record(3)))

    assert history.records[-1] == record(3)


def test_what_comes_back_is_published():
    bucket = MemoryBucket()

    History(bucket, "model").restore(1, fields_of(record(0)))

    assert read_history(bucket, "model") == [record(0)]


def test_figures_that_are_no_numbers_travel_in_a_checkpoint_too(history):
    odd = replace(record(3), kl=float("nan"), value_loss=float("inf"))

    history.restore(4, json.loads(json.dumps(fields_of(odd), allow_nan=False)))

    assert math.isnan(history.records[-1].kl)
    assert history.records[-1].best_lap_s is None
    assert history.records[-1].mean_reward == odd.mean_reward


def test_the_first_checkpoint_has_no_iteration_before_it(history):
    history.restore(0, None)

    assert history.records == []
