"""What running evaluations leave on this machine."""

import os
import time

import psutil
import pytest

from drcli.records.run_record import EvaluationRecord, claim, running_evaluations, sweep


@pytest.fixture
def note(tmp_path):
    """Puts down the note of an evaluation that this process waits for, or that is gone."""

    def write(stamp, *, run_id=0, alive=True):
        folder = claim(tmp_path, run_id, stamp)
        assert folder is not None
        started = psutil.Process().create_time()
        record = EvaluationRecord(
            run_id=run_id,
            stamp=stamp,
            bucket="bucket",
            prefix="model",
            world="reinvent_base",
            checkpoint="8_Step-4000.ckpt",
            pid=os.getpid(),
            pid_started=started if alive else started - 1000.0,
            worker_pid=os.getpid(),
            started_at=time.time(),
        )
        record.write(folder)
        return record

    return write


def test_a_name_is_given_away_once(tmp_path):
    first = claim(tmp_path, 0, "20260102030405")
    second = claim(tmp_path, 0, "20260102030405")
    elsewhere = claim(tmp_path, 1, "20260102030405")

    assert first is not None
    assert second is None
    assert elsewhere is not None


def test_only_what_lives_is_running(tmp_path, note):
    first, second = note("20260102030405"), note("20260102030406", run_id=3)
    note("20260102030407", alive=False)

    assert running_evaluations(tmp_path) == [first, second]
    assert running_evaluations(tmp_path, 3) == [second]
    assert running_evaluations(tmp_path, 4) == []


def test_a_folder_without_a_note_is_an_evaluation_that_is_only_starting(tmp_path):
    folder = claim(tmp_path, 0, "20260102030405")
    assert folder is not None

    sweep(tmp_path, 0)

    assert running_evaluations(tmp_path) == []
    assert folder.exists()


def test_what_killed_evaluations_left_is_swept_up(tmp_path, note):
    alive = note("20260102030405")
    note("20260102030406", alive=False)

    sweep(tmp_path, 0)

    folders = (tmp_path / "data" / "runs" / "0" / "evaluations").iterdir()
    assert [folder.name for folder in folders] == [alive.stamp]
