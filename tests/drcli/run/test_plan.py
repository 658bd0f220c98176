"""Starts that meet each other: the second one changes nothing."""

import errno
import json
import time
from collections import Counter
from pathlib import Path

import pytest

from drcli.base.errors import SettingsError, StorageError
from drcli.checks import before_start
from drcli.learn.algorithms import ALGORITHMS
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName
from drcli.records.run_record import RunRecord, log_file, run_folder
from drcli.run import plan, training
from memory_bucket import MemoryBucket
from own_run import own_run

THEIRS = {"session": "theirs", "host": "elsewhere", "pid": 1}
WEIGHTS = "model-1/model/1_Step-10.ckpt.safetensors"


@pytest.fixture
def during_examination(monkeypatch):
    """Lets something happen while the inputs are examined."""

    def happen(what):
        examine = before_start.examine

        def slow(*args):
            examined = examine(*args)
            what()
            return examined

        monkeypatch.setattr(before_start, "examine", slow)

    return happen


def test_a_training_elsewhere_that_began_meanwhile_is_left_alone(racer, during_examination):
    theirs = {
        keys.lease("model-1"): json.dumps({**THEIRS, "renewed": time.time()}).encode(),
        WEIGHTS: b"their weights",
        keys.reward_function("model-1"): b"# theirs",
    }

    def begins() -> None:
        for key, data in theirs.items():
            racer.bucket.put(key, data)

    during_examination(begins)

    with pytest.raises(SettingsError, match="is being trained by process 1 on elsewhere"):
        racer.start(wipe=True)

    assert {item.key: racer.bucket.get(item.key) for item in racer.bucket.list("")} == theirs


def test_a_training_of_the_same_run_that_began_meanwhile_is_left_alone(racer, during_examination):
    racer.bucket.put(WEIGHTS, b"their weights")

    def begins() -> None:
        own_run(session="theirs", world="oval").write(
            run_folder(racer.folder, racer.settings().run_id)
        )

    during_examination(begins)

    with pytest.raises(SettingsError, match="Run 0 is training"):
        racer.start(wipe=True)

    assert [item.key for item in racer.bucket.list("")] == [WEIGHTS]


def test_a_model_that_appeared_meanwhile_is_not_overwritten(racer, during_examination):
    during_examination(lambda: racer.bucket.put(WEIGHTS, b"their weights"))

    with pytest.raises(SettingsError, match="Selected path s3://bucket/model-1 exists"):
        racer.start()

    assert [item.key for item in racer.bucket.list("")] == [WEIGHTS]


def test_a_planned_start_keeps_the_prefix_until_its_supervisor_takes_over(racer):
    racer.bucket.put(WEIGHTS, b"old weights")
    first = plan.prepare(racer.settings(), plan.StartOptions(wipe=True))
    frozen = {item.key: racer.bucket.get(item.key) for item in racer.bucket.list("")}

    with pytest.raises(SettingsError, match="is being trained by process"):
        plan.prepare(racer.settings(), plan.StartOptions(wipe=True))

    assert {item.key: racer.bucket.get(item.key) for item in racer.bucket.list("")} == frozen
    held = lease.holder(ModelStore(racer.bucket, "model-1"))
    assert held is not None
    assert held.session == first.job.session


def test_the_supervisor_takes_the_prefix_over_from_its_start(racer, monkeypatch):
    class Ends:
        """A supervisor that has nothing to do."""

        def __init__(self, *_: object, **__: object) -> None:
            pass

        def run(self) -> int:
            return 6

    monkeypatch.setattr(training, "open_bucket", lambda *_, **__: racer.bucket)
    monkeypatch.setattr(training, "Supervisor", Ends)
    planned = plan.prepare(racer.settings(), plan.StartOptions())

    code = training.supervise_job(planned.job)

    record = RunRecord.read(planned.job.folder)
    assert code == 6
    assert record is not None
    assert record.session == planned.job.session


def test_a_resumed_start_loads_its_checkpoint_once(trained, monkeypatch):
    asked = Counter()
    get = trained.bucket.get

    def counted(key):
        asked[key] += 1
        return get(key)

    monkeypatch.setattr(trained.bucket, "get", counted)

    planned = trained.start(resume=True)

    assert asked[keys.checkpoint_tensors("model-1", planned.resumes)] == 1
    assert asked[keys.checkpoint_optimizer("model-1", planned.resumes)] == 1


def test_a_start_that_fails_halfway_gives_the_prefix_back(racer, monkeypatch):
    def fail(*_):
        raise StorageError("The bucket is gone.", remedy="Start it.")

    monkeypatch.setattr(plan, "describe_start", fail)

    with pytest.raises(StorageError):
        racer.start()

    assert lease.holder(ModelStore(racer.bucket, "model-1")) is None


@pytest.mark.parametrize(("rollouts", "warned"), [((), True), ((9,), True), ((7,), False)])
def test_a_start_says_that_a_copied_model_of_sac_has_lost_its_replay_buffer(rollouts, warned):
    bucket = MemoryBucket()
    for iteration in rollouts:
        bucket.put(keys.rollout_part("model-1", iteration, 0, "session", 0), b"steps")

    told = plan._replay_lost(
        ALGORITHMS["sac"], ModelStore(bucket, "model-1"), CheckpointName(8, 800)
    )

    assert ["empty replay buffer" in text for text in told] == [True] * warned
    assert (
        plan._replay_lost(ALGORITHMS["sac"], ModelStore(bucket, "model-1"), CheckpointName(0, 0))
        == []
    )


def test_a_start_over_begins_new_logs_and_a_resumed_one_goes_on_with_them(trained):
    settings, folder = trained.settings(), trained.folder
    log = log_file(folder, settings.model_prefix, "sim-0")
    log.write_text("first\n")
    trained.bucket.delete([keys.lease("model-1")])

    trained.start(resume=True)
    resumed = log.read_text()
    trained.bucket.delete([keys.lease("model-1")])
    trained.start(wipe=True)

    assert resumed == "first\n"
    assert not log.exists()
    [kept] = log.parent.glob("sim-0.log.*")
    assert kept.read_text() == "first\n"


def test_logs_that_cannot_be_renamed_are_named_and_the_model_is_free_again(racer, monkeypatch):
    log = log_file(racer.folder, racer.settings().model_prefix, "trainer")
    log.parent.mkdir(parents=True)
    log.touch()

    def refuse(path, target):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "rename", refuse)

    with pytest.raises(SettingsError, match=r"trainer\.log: logs cannot be written there"):
        racer.start()

    assert lease.holder(ModelStore(racer.bucket, "model-1")) is None
