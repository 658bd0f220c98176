import math
from dataclasses import replace

import pytest

from drcli.base.fingerprint import Fingerprint
from drcli.exchange.checkpoint import CheckpointRecord, Counters
from drcli.store.history import History, read_history
from iterations import iteration_record
from memory_bucket import MemoryBucket


@pytest.fixture
def history() -> History:
    history = History(MemoryBucket(), "model")
    for iteration in range(3):
        history.add(iteration_record(iteration))
    return history


def test_iterations_that_will_be_repeated_are_forgotten(history):
    history.restore(2, iteration_record(1))

    assert [r.iteration for r in history.records] == [0, 1]


def test_a_record_that_died_with_its_trainer_comes_back_with_the_checkpoint(history):
    history.restore(4, iteration_record(3))

    assert history.records[-1] == iteration_record(3)


def test_what_comes_back_is_published():
    bucket = MemoryBucket()

    History(bucket, "model").restore(1, iteration_record(0))

    assert read_history(bucket, "model") == [iteration_record(0)]


def test_numbers_that_are_unknown_travel_in_a_checkpoint_too(history):
    odd = replace(iteration_record(3), kl=float("nan"), value_loss=float("inf"))
    before = CheckpointRecord("4_Step-9.ckpt", Fingerprint.of(b""), counters=Counters(learned=odd))

    history.restore(4, CheckpointRecord.decode(before.encode()).counters.learned)

    assert math.isnan(history.records[-1].kl)
    assert history.records[-1].best_lap_s is None
    assert history.records[-1].mean_reward == odd.mean_reward


def test_the_first_checkpoint_has_no_iteration_before_it(history):
    history.restore(0, None)

    assert history.records == []
