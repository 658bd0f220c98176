"""Workers drive ahead of the trainer, as far as DR_TRAIN_MAX_LAG allows and no further."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import Queue
from typing import Any

import pytest
from safetensors.torch import save as save_tensors

from drcli.base.errors import SettingsError
from drcli.config.loading import load_settings
from drcli.convert.build_network import build_policy
from drcli.model.checkpoints import CheckpointStore, checkpoint_objects
from drcli.model.files.network_shape import Design
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters, checkpoint_name
from drcli.train.rollouts import Collector, find_manifest
from drcli.train.sim import SimWorker
from drcli.workers.cores import max_lag
from drcli.workers.worker_process import StopRequested
from training_in_memory import PREFIX, TrainingInMemory, UntilFailure

LAG, ITERATIONS = 3, 6


@pytest.fixture
def training(tmp_path, monkeypatch) -> TrainingInMemory:
    return TrainingInMemory(
        tmp_path,
        monkeypatch,
        DR_TRAIN_OVERLAP="on",
        DR_TRAIN_MAX_LAG=LAG,
        DR_TRAIN_MAX_ITERATIONS=ITERATIONS,
    )


class Worker:
    """A simulation worker whose trainer is the test."""

    def __init__(self, training: TrainingInMemory) -> None:
        self.bucket = training.bucket
        self.store = CheckpointStore(ModelStore(self.bucket, PREFIX))
        self.job = training.planned()
        self.waits: Queue[str] = Queue()
        design = Design.of_model(ModelStore(self.bucket, PREFIX))
        weights = build_policy(design.metadata, design.parameters).state_dict()
        self._tensors = save_tensors({name: t.contiguous() for name, t in weights.items()})

    def waits_for(self, checkpoint: int) -> None:
        """Come back when it has driven all that it may, and waits for this checkpoint."""
        while self.waits.get(timeout=60.0) != f"waits for the trainer (checkpoint {checkpoint})":
            pass

    def publish(self, number: int, **counters: Any) -> None:
        """The same weights again, as a checkpoint of this number."""
        self.store.save(number, 100 * number, self._tensors, counters=Counters(**counters))

    def drivers(self, iterations: range) -> list[int | None]:
        """Which checkpoint drove each of these iterations; None for none."""
        found = [find_manifest(ModelStore(self.bucket, PREFIX), each, 0) for each in iterations]
        return [None if each is None else checkpoint_name(each.checkpoint).number for each in found]


@contextmanager
def driving(training: TrainingInMemory, monkeypatch) -> Iterator[Worker]:
    """A worker that has a first checkpoint, until the test has seen enough."""
    worker, stop_signal = Worker(training), UntilFailure()
    worker.publish(0)
    sim = SimWorker(worker.job, stop_signal, 0)
    monkeypatch.setattr(sim._activity, "wait", worker.waits.put)
    monkeypatch.setattr(sim._waiter, "_say", worker.waits.put)

    def run() -> None:
        with suppress(StopRequested):
            sim.run()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield worker
    finally:
        stop_signal.failures.append(StopRequested())
        thread.join(60.0)


def test_a_worker_drives_ahead_up_to_the_limit_and_goes_back_with_the_trainer(
    training, monkeypatch
):
    with driving(training, monkeypatch) as worker:
        worker.waits_for(1)
        assert worker.drivers(range(5)) == [0, 0, 0, 0, None]

        worker.publish(2)
        worker.waits_for(3)
        assert worker.drivers(range(7)) == [0, 0, 0, 0, 2, 2, None]

        worker.publish(1)
        worker.waits_for(2)
        assert worker.drivers(range(7)) == [0, 1, 1, 1, 1, 2, None]


def test_the_trainer_learns_from_what_was_driven_ahead_and_from_nothing_older(
    training, monkeypatch
):
    written = threading.Condition()
    put, collect = training.bucket.put, Collector.collect

    def noted_put(*arguments: Any, **named: Any) -> None:
        put(*arguments, **named)
        with written:
            written.notify_all()

    def slow_collect(self: Collector, iteration: int, *arguments: Any) -> Any:
        """A trainer for which the worker is always as far ahead as it may be."""
        last = iteration + LAG
        with written:
            assert written.wait_for(
                lambda: find_manifest(ModelStore(training.bucket, PREFIX), last, 0), 60.0
            )
        return collect(self, iteration, *arguments)

    monkeypatch.setattr(training.bucket, "put", noted_put)
    monkeypatch.setattr(Collector, "collect", slow_collect)

    training.train()

    drove = [
        checkpoint_name(r.checkpoint).number
        for r in read_history(ModelStore(training.bucket, PREFIX))
    ]
    assert drove == [max(0, iteration - LAG) for iteration in range(ITERATIONS)]
    kept = {
        name.number for name in checkpoint_objects(ModelStore(training.bucket, PREFIX)).values()
    }
    assert kept >= set(range(ITERATIONS - LAG, ITERATIONS + 1))  # those that may have driven


def test_without_the_setting_everything_is_as_it_was(tmp_path):
    (tmp_path / "run.env").write_text("DR_THREADS=2\n")
    lags = {
        overlap: max_lag(load_settings(tmp_path, environ={"DR_TRAIN_OVERLAP": overlap}).run.train)
        for overlap in ("off", "on")
    }

    assert lags == {"off": 0, "on": 1}


def test_a_larger_lag_means_that_driving_and_learning_overlap(tmp_path):
    (tmp_path / "run.env").write_text("DR_THREADS=1\nDR_TRAIN_MAX_LAG=4\n")

    assert max_lag(load_settings(tmp_path, environ={}).run.train) == 4
    with pytest.raises(SettingsError, match="DR_TRAIN_OVERLAP=off forbids that"):
        load_settings(tmp_path, environ={"DR_TRAIN_OVERLAP": "off"})
