import math
from dataclasses import replace

import pytest

from drcli.base.fingerprint import Fingerprint
from drcli.exchange.checkpoint import CheckpointRecord, Counters
from drcli.exchange.iteration import IterationRecord
from drcli.store.history import History, read_history
from memory_bucket import MemoryBucket


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
    history.restore(2, record(1))

    assert [r.iteration for r in history.records] == [0, 1]


def test_a_record_that_died_with_its_trainer_comes_back_with_the_checkpoint(history):
    history.restore(4, record(3))

    assert history.records[-1] == record(3)


def test_what_comes_back_is_published():
    bucket = MemoryBucket()

    History(bucket, "model").restore(1, record(0))

    assert read_history(bucket, "model") == [record(0)]


def test_numbers_that_are_unknown_travel_in_a_checkpoint_too(history):
    odd = replace(record(3), kl=float("nan"), value_loss=float("inf"))
    before = CheckpointRecord("4_Step-9.ckpt", Fingerprint.of(b""), counters=Counters(learned=odd))

    history.restore(4, CheckpointRecord.decode(before.encode()).counters.learned)

    assert math.isnan(history.records[-1].kl)
    assert history.records[-1].best_lap_s is None
    assert history.records[-1].mean_reward == odd.mean_reward


def test_the_first_checkpoint_has_no_iteration_before_it(history):
    history.restore(0, None)

    assert history.records == []
