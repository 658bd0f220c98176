"""A worker that has joined leaves an iteration from which the trainer has learned without it."""

from collections.abc import Callable

import pytest

from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName
from drcli.records.job import Shares, WorkerShare
from drcli.train.rollouts import find_manifest
from drcli.train.sim import SimWorker
from drcli.workers.worker_process import StopRequested
from training_in_memory import PREFIX, TrainingInMemory, UntilFailure


class Place:
    """The place of a worker in a training that goes on without it, or does not."""

    def __init__(self, stop_signal: UntilFailure, *, over: bool) -> None:
        self._stop_signal = stop_signal
        self._over = over
        self.seen: list[int] = []
        self.driven: list[int] = []

    def is_ready(self, checkpoint: int) -> None:
        self.seen.append(checkpoint)
        if checkpoint >= 0:  # it has done with it what it could
            self._stop_signal.failures.append(StopRequested())

    def shares_of(self, iteration: int) -> Shares:
        return Shares(1, iteration, iteration, (WorkerShare(0, "far", 0, 2),))

    def is_reassigned(self, _name: CheckpointName) -> bool:
        return False

    def begin_drive(self, iteration: int, steps: Callable[[], int]) -> None:
        assert steps() == 0
        self.driven.append(iteration)

    def is_drive_over(self) -> bool:
        return self._over

    def end_drive(self) -> None:
        self.driven.append(-1)


@pytest.mark.parametrize("over", [False, True])
def test_a_worker_that_nobody_waits_for_goes_on_to_the_next_checkpoint(
    working_folder, monkeypatch, over, logged
):
    training = TrainingInMemory(working_folder, monkeypatch, DR_TRAIN_MAX_ITERATIONS=1)
    training.train()
    training.write("run.env", (working_folder / "run.env").read_text() + "DR_WORKERS=0\n")
    job = training.planned(resume=True)
    stop_signal = UntilFailure()
    place = Place(stop_signal, over=over)

    with pytest.raises(StopRequested):
        SimWorker(job, stop_signal, 0, membership=place).run()

    assert place.seen == [-1, 1]
    assert place.driven == [1, -1]
    delivered = find_manifest(ModelStore(training.bucket, PREFIX), 1, 0)
    assert (delivered is None) == over
    assert ("went on without this worker's iteration 1" in logged()) == over
