"""A time limit ends a training in the middle of an update, and what was learned is kept."""

import json

from drcli.model.checkpoints import CheckpointStore
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore
from drcli.records.job import WorkerExit
from drcli.train import trainer
from drcli.train.goals import Goals
from training_in_memory import PREFIX, TrainingInMemory


def test_an_update_without_end_is_saved_when_the_time_is_over(tmp_path, monkeypatch):
    training = TrainingInMemory(tmp_path, monkeypatch)
    endless = {"batch_size": 32, "num_epochs": 1_000_000, "num_episodes_between_training": 2}
    training.write("custom_files/hyperparameters.json", json.dumps(endless))
    now_s = 0.0

    def clocked(*arguments, **options) -> Goals:
        return Goals(*arguments, clock=lambda: now_s, **options)

    def pass_time(*_) -> None:
        nonlocal now_s
        now_s = 61.0

    monkeypatch.setattr(trainer, "Goals", clocked)
    monkeypatch.setattr(trainer.Trainer, "_log_epoch", pass_time)

    training.train(max_minutes=1.0)

    assert len(read_history(ModelStore(training.bucket, PREFIX))) == 1
    found = CheckpointStore(ModelStore(training.bucket, PREFIX)).load_latest(with_optimizer=True)
    assert (found.record.number, found.record.counters.learned.iteration) == (1, 0)
    assert found.optimizer is not None
    ended = WorkerExit.read(training.planned(resume=True).folder, "trainer")
    assert ended.message == "Training is complete: the time limit (1 minute) was reached."
