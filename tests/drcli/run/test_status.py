"""What is said about a run, from the note that its supervisor leaves."""

import os
import time
from dataclasses import replace

import pytest

from drcli.base.clock import elapsed_s
from drcli.model import keys
from drcli.model.best_checkpoint import write_evaluation
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.records import run_record
from drcli.records.checkpoint import Counters
from drcli.records.heartbeat import WatchRecord, open_heartbeat_file
from drcli.records.iteration import encode_history
from drcli.records.run_record import (
    ActivityRecord,
    Lease,
    RunRecord,
    StorageRecord,
    WorkerRecord,
    run_folder,
)
from drcli.records.scores import EvaluationResult, SecondEvaluation
from drcli.records.stage import RangesMark
from drcli.records.training_record import RunOutcome
from drcli.run.heartbeat_monitor import WorkerHealth
from drcli.run.status import inspect
from drcli.workers.heartbeat_thread import Heartbeat
from memory_bucket import MemoryBucket
from own_run import own_run


@pytest.fixture
def running(racer):
    """A run whose supervisor is this process."""
    note = own_run()
    note.write(run_folder(racer.folder, racer.settings().run_id))
    return note


def test_a_run_that_ends_while_it_is_looked_at_has_ended_well(racer, running, monkeypatch):
    def ends_in_this_moment(pid: int, pid_started: float) -> bool:
        ended = running.ended("finished", 0, "Training is complete.", "", time.time())
        ended.write(run_folder(racer.folder, racer.settings().run_id))
        return False

    monkeypatch.setattr(run_record, "is_alive", ends_in_this_moment)

    report = inspect(racer.settings().run)

    assert (report.state, report.message) == ("finished", "Training is complete.")


def test_a_run_whose_supervisor_is_gone_without_a_word_is_lost(racer, running, monkeypatch):
    monkeypatch.setattr(run_record, "is_alive", lambda pid, pid_started: False)

    report = inspect(racer.settings().run)

    assert report.state == "lost"
    assert "--resume" in report.remedy


def test_a_run_with_a_living_supervisor_is_running(racer, running):
    assert inspect(racer.settings().run).state == "running"


def test_a_run_is_looked_at_in_the_bucket_and_under_the_name_it_was_started_with(racer, running):
    began = racer.settings()
    replace(running, storage=StorageRecord.of(began.storage, racer.folder)).write(
        run_folder(racer.folder, began.run_id)
    )
    now = began.replaced(
        cloud="remote", remote_minio_url="http://127.0.0.1:9", model_prefix="other"
    )

    report = inspect(now.run)

    assert report.prefix == "model-1"
    assert all("does not answer" not in worker.activity for worker in report.workers)


def test_a_bucket_that_does_not_answer_is_said(racer, running):
    elsewhere = racer.settings().replaced(
        cloud="remote", remote_minio_url="http://127.0.0.1:9", model_prefix="model-1"
    )
    replace(running, storage=StorageRecord.of(elsewhere.storage, racer.folder)).write(
        run_folder(racer.folder, elsewhere.run_id)
    )

    assert "127.0.0.1:9" in inspect(elsewhere.run).unreachable


def test_a_model_whose_index_is_lost_still_has_its_checkpoints(racer, running, monkeypatch):
    bucket = MemoryBucket()
    CheckpointStore(ModelStore(bucket, running.prefix)).save(4, 100, b"weights")
    bucket.delete([keys.deepracer_checkpoints(running.prefix)])
    monkeypatch.setattr("drcli.run.status.open_running_bucket", lambda _: bucket)

    report = inspect(racer.settings().run)

    assert report.last is not None
    assert report.last.name == "4_Step-100.ckpt"


def test_a_run_says_how_much_of_its_ranges_is_drawn(racer, running, make_record, monkeypatch):
    monkeypatch.setattr("drcli.run.status.open_running_bucket", lambda *_: racer.bucket)
    store = racer.store(running.prefix)
    store.save(4, 100, b"weights", counters=Counters(ranges=RangesMark(0.5, 4)))
    racer.bucket.put(keys.history(running.prefix), encode_history([make_record(3)]))
    run = racer.settings().run
    grows = replace(run, races=(run.race().replaced(sim_grow=True),))

    assert inspect(run).phase_text() == ""
    assert inspect(grows).phase_text() == "50% of the DR_SIM_ ranges (DR_SIM_GROW)"


def test_the_bucket_of_a_run_is_that_of_its_start(racer, running):
    began = racer.settings()
    note = replace(running, storage=StorageRecord.of(began.storage, racer.folder))

    now = began.replaced(cloud="aws", bucket="another", local_s3_port=4711).storage
    found = note.storage_at_start(now, racer.folder)

    assert found == replace(began.storage, port=4711)


def test_a_worker_has_its_progress_and_memory_and_the_watches_their_say(racer, running):
    folder = run_folder(racer.folder, racer.settings().run_id)
    here = replace(running, workers=[WorkerRecord("sim-0", os.getpid(), 1)])
    here.write(folder)
    WatchRecord("one", ["sim-0 grows steadily."]).write(folder)
    heartbeat = Heartbeat()
    heartbeat.step_done()
    descriptor = open_heartbeat_file(folder, "sim-0")
    os.pwrite(descriptor, heartbeat.record().file_content(), 0)
    os.close(descriptor)

    report = inspect(racer.settings().run)

    [worker] = report.workers
    assert worker.health is not None
    assert worker.health.steps == 1
    assert 0.0 <= worker.health.progress_age_s < 60.0
    assert worker.health.memory_mb > 1.0
    assert worker.health.words("sim-0").startswith("last frame ")
    assert report.watches == ["sim-0 grows steadily."]


@pytest.mark.parametrize("pid", [1, None])
def test_the_pulse_of_another_process_says_nothing(tmp_path, pid):
    descriptor = open_heartbeat_file(tmp_path, "sim-0")
    os.pwrite(descriptor, Heartbeat().record().file_content(), 0)
    os.close(descriptor)

    assert WorkerHealth.of(tmp_path, "sim-0", pid) is None


def test_a_pulse_from_before_the_last_boot_says_nothing(tmp_path):
    heartbeat = replace(Heartbeat().record(), written_s=elapsed_s() + 9000.0)
    descriptor = open_heartbeat_file(tmp_path, "sim-0")
    os.pwrite(descriptor, heartbeat.file_content(), 0)
    os.close(descriptor)

    assert WorkerHealth.of(tmp_path, "sim-0", os.getpid()) is None


def test_a_silent_worker_is_shown_as_such():
    health = WorkerHealth(0, None, 45.0, 512.4, 19)

    assert health.words("trainer") == "no gradient step yet, silent for 45 s, 512 MB"


def test_a_busy_worker_shows_how_many_cores_it_uses():
    health = WorkerHealth(9, 2.0, 1.0, 512.4, 19, 1.84)

    assert health.words("sim-0") == "last frame 2 s ago, 512 MB, 1.8 cores"


def test_warnings_of_an_earlier_start_are_over(tmp_path):
    WatchRecord("one", ["sim-0 grows steadily."]).write(tmp_path)

    assert WatchRecord.of_session(tmp_path, "two").warnings == []


@pytest.fixture
def elsewhere(racer):
    """Lays down how the newest start of model-1 ended, on a machine that is not this one."""

    def lay_down(**changes):
        outcome = RunOutcome("s", "a-spot-machine", 1.0, 2.0, **changes)
        config = racer.settings().storage
        path = config.data_dir / config.bucket / keys.outcome("model-1")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(outcome.encode())
        return inspect(racer.settings().run)

    return lay_down


def test_a_run_that_was_interrupted_on_another_machine_is_known_here(elsewhere):
    report = elsewhere(state="interrupted", code=75, message="EC2 took it.", remedy="Go on.")

    assert (report.state, report.exit_code, report.pid) == ("interrupted", 75, None)
    assert report.message == "On a-spot-machine: EC2 took it."
    assert report.remedy == "Go on."


def test_a_run_on_another_machine_that_has_not_ended_is_none_of_this_folder(elsewhere):
    assert elsewhere().state == "none"


def test_a_training_on_another_machine_is_said_where_nothing_was_started(elsewhere, racer):
    elsewhere()
    config = racer.settings().storage
    theirs = Lease("theirs", "elsewhere", 77, time.time(), machine="another", term=3)
    (config.data_dir / config.bucket / keys.lease("model-1")).write_bytes(theirs.encode())

    report = inspect(racer.settings().run)

    assert report.state == "none"
    assert "s3://bucket/model-1 is being trained by process 77 on elsewhere" in report.elsewhere


def test_a_training_on_another_machine_is_followed_to_its_end(elsewhere, racer):
    elsewhere()
    config = racer.settings()
    folder = config.storage.data_dir / config.storage.bucket
    theirs = Lease("s", "attic", 77, time.time(), machine="another", term=3)
    does = ActivityRecord("drives iteration 4", time.time(), 8, "attic")
    for key, record in ((keys.lease("model-1"), theirs), (keys.status("model-1", "sim-0"), does)):
        (folder / key).parent.mkdir(parents=True, exist_ok=True)
        (folder / key).write_bytes(record.encode())
    before = RunRecord(0, "ours", "bucket", "model-1", "bean", "finished", 1, 1.0, 0.5)
    before.write(run_folder(racer.folder, 0))

    during = inspect(config.run, anywhere=True)
    elsewhere(state="finished", code=0, message="All laps.")
    (folder / keys.lease("model-1")).unlink()
    after = inspect(config.run, anywhere=True)

    assert (during.state, during.pid, during.started_at) == ("running", None, 2.0)
    assert [worker.line(ending=False) for worker in during.workers] == [
        "sim-0 on attic: drives iteration 4"
    ]
    assert during.dead == []
    assert (after.state, after.message) == ("finished", "On a-spot-machine: All laps.")
    assert inspect(config.run).message == ""


def test_laps_of_the_best_are_of_the_training_track_whichever_track_chose_it(
    racer, running, monkeypatch
):
    monkeypatch.setattr("drcli.run.status.open_running_bucket", lambda *_: racer.bucket)
    store = racer.store(running.prefix)
    store.save(3, 300, b"weights")
    second = SecondEvaluation([100.0] * 2, [1.0] * 2, [7.0, 7.1], "oval")
    driven = EvaluationResult("3_Step-300.ckpt", [50.0, 100.0], [1.0] * 2, [9.0], second=second)
    write_evaluation(ModelStore(racer.bucket, running.prefix), 3, driven)
    store.record_evaluation(driven, "progress", "both")

    laps = inspect(racer.settings().run).best_laps

    assert laps is not None
    assert (laps.checkpoint, laps.text) == (3, "1 of 2 laps clean, 9.00 s")
