"""Disks that fill up under a run."""

import os
from pathlib import Path

import pytest

from drcli.run.disk_watch import Disk, DiskWatch, largest, measure
from watched_run import WatchedRun

GB = 10**9
TEMPORARY = Path("/elsewhere")


class Stage:
    """A run whose disk has as much room as a test says."""

    def __init__(self, folder, monkeypatch, **settings):
        monkeypatch.setattr("tempfile.gettempdir", lambda: str(TEMPORARY))
        self.run = WatchedRun(folder, **settings)
        self.free = {"data": 100.0 * GB, "temporary": 1.0 * GB}
        self.total = 1000 * GB
        self.files = 10**6
        self.watch = DiskWatch(self.run.running, clock=self.run.clock, measure=self.measure)

    def measure(self, folder):
        if folder == TEMPORARY:
            return Disk(folder, 2, GB, int(self.free["temporary"]), None)
        return Disk(folder, 1, self.total, int(self.free["data"]), self.files)

    def pass_time(self, minutes, gb_per_hour=0.0):
        for _ in range(int(minutes * 6)):
            self.run.now_s += 10.0
            self.free["data"] -= gb_per_hour * GB / 360.0
            self.watch.work()
            if outcome := self.watch.check():
                return outcome
        return None


@pytest.fixture
def stage(tmp_path, monkeypatch):
    return Stage(tmp_path, monkeypatch)


def test_a_disk_with_room_is_not_named(stage):
    assert stage.pass_time(60, gb_per_hour=0.1) is None
    assert stage.run.told == []


def test_a_disk_that_fills_is_named_early_and_again_when_it_becomes_urgent(stage):
    stage.free["data"] = 20 * GB

    stage.pass_time(6 * 60, gb_per_hour=3.0)

    told = stage.run.told
    assert "at the present rate they last for 6 h" in told[0]
    assert "The training stops at 500 MB (DR_DISK_MIN_MB)" in told[0]
    assert "DR_S3_DATA_DIR" in told[0]
    assert "at the present rate they last for 2 h 59 min" in told[1] or "3 h" in told[1]
    assert 2 <= len(told) <= 3
    assert stage.run.warnings == [told[-1]]


def test_the_run_ends_before_the_disk_is_full(stage):
    stage.free["data"] = 3 * GB

    outcome = stage.pass_time(60, gb_per_hour=3.0)

    assert outcome.code == 4
    assert stage.free["data"] > 0.49 * GB
    assert outcome.message.startswith("Only 500 MB are left on the disk of ")
    assert "DR_DISK_MIN_MB" in outcome.message
    assert "`dr-start-training --resume`" in outcome.remedy


def test_what_takes_the_room_is_named(stage, tmp_path):
    model = tmp_path / "data" / "s3" / "bucket" / "old-model" / "model"
    model.mkdir(parents=True)
    (model / "weights").write_bytes(b"x" * 3_000_000)
    logs = tmp_path / "data" / "logs" / "model"
    logs.mkdir(parents=True)
    (logs / "sim-0.log").write_bytes(b"x" * 1_000_000)
    stage.free["data"] = 0.1 * GB

    outcome = stage.pass_time(1)

    assert f"The largest: model {model.parent} 3 MB, logs {logs.parent} 1 MB." in outcome.message


def test_a_disk_without_room_for_new_files_ends_the_run_too(stage):
    stage.files = 15_000
    assert stage.pass_time(1) is None
    assert "room for 15,000 more files" in stage.run.told[0]

    stage.files = 1_500
    outcome = stage.pass_time(1)

    assert outcome.code == 4
    assert "1,500 more files" in outcome.message


def test_a_small_disk_may_be_filled_further(tmp_path, monkeypatch):
    stage = Stage(tmp_path, monkeypatch)
    stage.total, stage.free["data"] = int(0.1 * GB), 0.02 * GB

    assert stage.pass_time(1) is None
    stage.free["data"] = 0.009 * GB
    assert stage.pass_time(1).code == 4


def test_the_limit_can_be_set_or_switched_off(tmp_path, monkeypatch):
    stage = Stage(tmp_path, monkeypatch, DR_DISK_MIN_MB=0)
    stage.free["data"] = 0.001 * GB

    assert stage.pass_time(1) is None
    assert len(stage.run.told) == 1


def test_room_that_comes_back_ends_the_warning(stage):
    stage.free["data"] = GB
    stage.pass_time(1)
    assert stage.run.warnings

    stage.free["data"] = 100 * GB
    stage.pass_time(1)

    assert stage.run.warnings == []


def test_the_folder_for_temporary_files_is_watched_and_ends_nothing(stage):
    stage.free["temporary"] = 0.01 * GB

    assert stage.pass_time(1) is None

    [told] = stage.run.told
    assert told.startswith(f"Only 10 MB are left in {TEMPORARY}")


def test_a_bucket_elsewhere_needs_no_room_for_models(tmp_path, monkeypatch):
    stage = Stage(tmp_path, monkeypatch, DR_CLOUD="remote", DR_REMOTE_MINIO_URL="http://there")
    stage.free["data"] = GB
    stage.pass_time(1)

    assert "DR_S3_DATA_DIR" not in stage.run.told[0]


def test_a_real_disk_is_measured(tmp_path):
    disk = measure(tmp_path / "not" / "there" / "yet")

    assert disk is not None
    assert 0 <= disk.free_bytes <= disk.total_bytes
    assert disk.device == tmp_path.stat().st_dev


def test_files_that_vanish_while_they_are_counted_do_no_harm(tmp_path, monkeypatch):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "gone").write_text("x")
    real = os.lstat

    def vanished(path, *rest, **more):
        if str(path).endswith("gone"):
            raise FileNotFoundError
        return real(path, *rest, **more)

    monkeypatch.setattr(os, "lstat", vanished)

    assert largest(None, tmp_path) == []
