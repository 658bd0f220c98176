"""The log of a training names each thing that goes wrong once."""

import logging

from drcli.model.checkpoints import CheckpointStore
from drcli.model.history import History
from drcli.model.model_store import ModelStore
from drcli.train import training_progress
from drcli.train.training_progress import LearningAlarms
from iterations import iteration_record
from memory_bucket import MemoryBucket


def test_a_collapse_is_named_once_until_the_car_drives_well_again(monkeypatch, caplog):
    monkeypatch.setattr(training_progress, "_logger", logging.getLogger("alarms"))
    bucket = MemoryBucket()
    history = History(ModelStore(bucket, "model"))
    alarms = LearningAlarms(history, CheckpointStore(ModelStore(bucket, "model")))
    found = []

    for n, progress in enumerate([98.0] * 3 + [10.0] * 4 + [98.0] * 3 + [10.0] * 3):
        history.add(iteration_record(n, mean_progress=progress))
        found.append(alarms.check())

    fallen = [n for n, sentence in enumerate(found) if sentence is not None]
    warned = [message for message in caplog.messages if message.startswith("completion fell")]
    assert fallen == [4, 5, 6, 7, 11, 12]
    assert warned == [f"{found[n]}." for n in (4, 11)]
    alarms.begin_stage()
    alarms.check()
    assert caplog.messages[-1] == f"{found[12]}."
