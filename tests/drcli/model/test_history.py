import json
import math
from dataclasses import replace

import pytest

from drcli.base.json_record import Fingerprint
from drcli.model import keys
from drcli.model.growing_file import list_parts
from drcli.model.history import REMEMBERED, History, HistoryReader, collapse, read_history
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointRecord, Counters
from evaluations import evaluated
from iterations import iteration_record
from memory_bucket import MemoryBucket


@pytest.fixture
def history() -> History:
    history = History(ModelStore(MemoryBucket(), "model"))
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

    History(ModelStore(bucket, "model")).restore(1, iteration_record(0))

    assert read_history(ModelStore(bucket, "model")) == [iteration_record(0)]


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


@pytest.fixture
def long() -> tuple[MemoryBucket, History]:
    bucket = MemoryBucket()
    history = History(ModelStore(bucket, "model"))
    for iteration in range(700):
        history.add(iteration_record(iteration))
    return bucket, history


def test_a_long_history_is_read_back_while_it_is_written(long):
    bucket, history = long
    history.add_evaluation(699, evaluated("699_Step-1.ckpt", 50.0))
    history.add_evaluation(10, evaluated("10_Step-1.ckpt", 60.0))

    found = read_history(ModelStore(bucket, "model"))

    assert list_parts(bucket, keys.history("model"))
    assert [r.iteration for r in found] == list(range(700))
    assert (found[699].evaluation_progress, found[10].evaluation_progress) == ([50.0], [60.0])


def test_after_its_end_other_programs_find_everything_in_one_object(long):
    bucket, history = long

    history.finish()

    assert not list_parts(bucket, keys.history("model"))
    assert len(json.loads(bucket.get(keys.history("model")))["iterations"]) == 700


def test_a_killed_trainer_loses_no_iteration_and_repeats_none(long):
    bucket, _ = long

    second = History(ModelStore(bucket, "model"))
    second.restore(650, iteration_record(649))
    second.add(iteration_record(650, mean_reward=9.0))

    found = read_history(ModelStore(bucket, "model"))
    assert [r.iteration for r in found] == list(range(651))
    assert found[650].mean_reward == 9.0


def test_a_reader_that_looks_again_reads_only_what_has_changed(long, monkeypatch):
    bucket, history = long
    reader = HistoryReader()
    reader.read(ModelStore(bucket, "model"))
    history.add(iteration_record(700))
    read = []
    real = bucket.get
    monkeypatch.setattr(bucket, "get", lambda key, **_: read.append(key) or real(key))

    found = reader.read(ModelStore(bucket, "model"))

    assert [r.iteration for r in found] == list(range(701))
    assert len(read) == 1


def test_the_memory_of_old_iterations_is_freed_but_goals_and_collapse_still_know_them():
    history = History(ModelStore(MemoryBucket(), "model"))
    records = [
        iteration_record(n, mean_progress=90.0 if n < 5 else 20.0) for n in range(3 * REMEMBERED)
    ]
    records[3] = replace(records[3], evaluation_progress=[90.0])
    for record in records:
        history.add(record)

    assert len(history.records) <= 2 * REMEMBERED + 1
    assert history.records[0].iteration == 3
    assert history.count == 3 * REMEMBERED
    assert history.collapse(None) == collapse(records, None)
    assert history.collapse(None) is not None
    assert history.iterations_of(250_000) == 2500
