"""Logs in the bucket: each byte once, in order, also after rotations, restarts and faults."""

import os
import threading
import time

import pytest

from drcli.base import log as log_files
from drcli.base.errors import StorageError
from drcli.config.loading import load_settings
from drcli.records.run_record import json_log, log_file
from drcli.run import run_logs
from drcli.run.run_logs import LogCopy, LogUpload, begin_logs, empty_logs
from memory_bucket import MemoryBucket

KEY = "model/logs/robomaker/sim-0.log"
PART = 1000
MAX_BYTES = 100_000


class Counting(MemoryBucket):
    """A bucket that counts what is written, and may refuse to be written to."""

    def __init__(self):
        super().__init__()
        self.written = 0
        self.refuses = False

    def put(self, key, data, *, watch=None):
        if self.refuses:
            raise StorageError("Nothing answers.", remedy="Wait.")
        self.written += len(data)
        super().put(key, data, watch=watch)

    def copy_of(self, key=KEY):
        """The log as somebody who downloads it puts it together."""
        parts = sorted(i.key for i in self.list("") if i.key.startswith(f"{key}.part-"))
        return b"".join(self.get(part) for part in [*parts, key]).decode()


@pytest.fixture(autouse=True)
def _small_parts(monkeypatch):
    monkeypatch.setattr(run_logs, "PART_BYTES", PART)


@pytest.fixture
def bucket():
    return Counting()


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "sim-0.log"
    path.touch()
    return path


def lines(first, last):
    return "".join(f"line {k:06d}\n" for k in range(first, last))


def add(log, text):
    with log.open("a") as file:
        file.write(text)


def rotate(log, max_bytes=10**9):
    os.close(log_files.rotate(log, max_bytes))


def test_a_short_log_is_one_object(bucket, log):
    add(log, lines(0, 10))

    LogCopy(bucket, KEY, log, MAX_BYTES).update()

    assert [info.key for info in bucket.list("")] == [KEY]
    assert bucket.copy_of() == lines(0, 10)


def test_a_log_that_grows_is_uploaded_once_but_for_its_newest_part(bucket, log):
    copy = LogCopy(bucket, KEY, log, MAX_BYTES)

    for k in range(0, 2000, 20):
        add(log, lines(k, k + 20))
        copy.update()
        copy.update()  # nothing new: nothing travels

    size = log.stat().st_size
    assert bucket.copy_of() == lines(0, 2000)
    assert bucket.written < size + 100 * PART
    assert copy.left_bytes() == 0


def test_parts_end_with_a_line(bucket, log):
    add(log, lines(0, 1000))

    LogCopy(bucket, KEY, log, MAX_BYTES).update()

    parts = [info.key for info in bucket.list("") if ".part-" in info.key]
    assert len(parts) > 5
    assert all(bucket.get(part).endswith(b"\n") for part in parts)


@pytest.mark.parametrize("seen", [0, 1, 2])
def test_a_rotated_log_goes_on_in_the_bucket(bucket, log, seen):
    copy = LogCopy(bucket, KEY, log, MAX_BYTES)
    text = ""
    for k in range(3):
        add(log, lines(500 * k, 500 * k + 250))
        if k == seen:
            copy.update()
        add(log, lines(500 * k + 250, 500 * k + 500))
        text += lines(500 * k, 500 * k + 500)
        rotate(log)
    add(log, "newest\n")

    copy.update()

    assert bucket.copy_of() == text + "newest\n"


def test_what_was_deleted_before_it_was_uploaded_is_passed_over(bucket, log):
    copy = LogCopy(bucket, KEY, log, MAX_BYTES)
    add(log, lines(0, 100))
    copy.update()
    for k in range(1, 5):
        rotate(log, max_bytes=1000)
        add(log, lines(100 * k, 100 * k + 100))

    copy.update()

    assert bucket.copy_of().endswith(lines(300, 500))
    assert copy.left_bytes() == 0


def test_older_parts_that_somebody_deletes_are_not_waited_for(bucket, log):
    copy = LogCopy(bucket, KEY, log, MAX_BYTES)
    rotate(log)
    add(log, lines(0, 10))
    copy.update()
    log_files.older_parts(log)[0].unlink()

    copy.update()

    assert bucket.copy_of() == lines(0, 10)


def test_the_oldest_parts_go_where_the_copy_grows_too_large(bucket, log):
    add(log, lines(0, 1000))

    LogCopy(bucket, KEY, log, 3 * PART).update()

    text = bucket.copy_of()
    assert len(text) <= 4 * PART
    assert text.endswith(lines(900, 1000))


def test_a_later_start_goes_on_where_the_last_one_ended(bucket, log):
    add(log, lines(0, 500))
    LogCopy(bucket, KEY, log, MAX_BYTES).update()
    before = bucket.written
    add(log, lines(500, 550))

    LogCopy(bucket, KEY, log, MAX_BYTES).update()

    assert bucket.copy_of() == lines(0, 550)
    assert bucket.written < before + 2 * PART


def test_another_machine_adds_to_the_copy(bucket, log, tmp_path):
    add(log, lines(0, 500))
    LogCopy(bucket, KEY, log, MAX_BYTES).update()
    (tmp_path / "other").mkdir()
    elsewhere = tmp_path / "other" / "sim-0.log"
    elsewhere.write_text("another machine\n")

    LogCopy(bucket, KEY, elsewhere, MAX_BYTES).update()

    assert bucket.copy_of() == lines(0, 500) + "another machine\n"


def test_a_log_whose_position_is_lost_is_uploaded_again_without_a_double_newest_part(bucket, log):
    add(log, lines(0, 20))
    LogCopy(bucket, KEY, log, MAX_BYTES).update()
    (log.parent / "sim-0.log.uploaded").unlink(missing_ok=True)
    add(log, lines(20, 30))

    LogCopy(bucket, KEY, log, MAX_BYTES).update()

    assert bucket.copy_of() == lines(0, 30)


@pytest.mark.parametrize(
    "note", ["", "{", "[]", '{"number": 7, "offset": 0}', '{"number": 1, "offset": 99999}']
)
def test_a_damaged_position_counts_as_none(bucket, log, note):
    add(log, lines(0, 20))
    (log.parent / "sim-0.log.uploaded").write_text(note)

    LogCopy(bucket, KEY, log, MAX_BYTES).update()

    assert bucket.copy_of() == lines(0, 20)


def test_where_time_is_short_the_end_of_a_log_goes_first(bucket, log):
    add(log, lines(0, 1000))
    copy = LogCopy(bucket, KEY, log, MAX_BYTES)

    copy.update(lambda: True, hurried=True)

    assert bucket.get(KEY).decode().endswith(lines(950, 1000))
    assert copy.left_bytes() > 0


def test_the_end_of_a_log_that_was_just_rotated_is_in_its_older_part(bucket, log):
    add(log, lines(0, 1000))
    rotate(log)
    add(log, "newest\n")

    LogCopy(bucket, KEY, log, MAX_BYTES).update(lambda: True, hurried=True)

    assert bucket.get(KEY).decode().endswith(lines(950, 1000) + "newest\n")


class Stage:
    """An upload of two logs."""

    def __init__(self, folder, open_bucket, system=""):
        (folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model\n")
        (folder / "system.env").write_text(system)
        self.folder = folder
        self.settings = load_settings(folder, environ={})
        self.upload = LogUpload(
            open_bucket, folder, "model", self.settings.run.logs, ["trainer", "sim-0"]
        )

    def log(self, name):
        path = log_file(self.folder, self.settings.model_prefix, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


def test_the_last_upload_completes_all_logs_and_says_nothing(bucket, tmp_path, logged):
    stage = Stage(tmp_path, lambda: bucket)
    stage.log("sim-0").write_text(lines(0, 500))
    stage.log("trainer").write_text("I learn\n")
    stage.upload.start()

    stage.upload.finish(30.0)

    assert bucket.copy_of() == lines(0, 500)
    assert bucket.get("model/logs/sagemaker/trainer.log") == b"I learn\n"
    assert logged() == ""


def test_a_network_that_never_answers_delays_the_end_no_longer_than_allowed(
    bucket, tmp_path, logged
):
    never = threading.Event()
    stage = Stage(tmp_path, lambda: never.wait() and bucket)
    stage.log("sim-0").write_text("unheard\n")
    stage.upload.start()

    began = time.monotonic()
    stage.upload.finish(0.05)

    assert time.monotonic() - began < 10.0
    assert "could not be uploaded in time" in logged()
    never.set()


def test_a_second_request_does_not_wait_for_the_upload(bucket, tmp_path, logged):
    never = threading.Event()
    stage = Stage(tmp_path, lambda: never.wait() and bucket)
    stage.log("sim-0").touch()
    stage.upload.start()

    stage.upload.finish(3600.0, lambda: True)

    assert "could not be uploaded in time" in logged()
    never.set()


def test_a_slow_network_is_given_up_between_two_parts(tmp_path, logged):
    class Slow(Counting):
        def put(self, key, data, *, watch=None):
            time.sleep(0.02)
            super().put(key, data, watch=watch)

    bucket = Slow()
    stage = Stage(tmp_path, lambda: bucket)
    stage.log("sim-0").write_text(lines(0, 100_000))
    stage.upload.start()

    stage.upload.finish(0.3)

    assert 0 < bucket.written < 1_000_000
    assert "MB of the logs could not be uploaded in time" in logged()


def test_an_outage_is_said_and_the_next_upload_makes_up_for_it(
    bucket, tmp_path, monkeypatch, logged
):
    monkeypatch.setattr(run_logs, "INTERVAL_S", 0.01)
    stage = Stage(tmp_path, lambda: bucket)
    stage.log("sim-0").write_text(lines(0, 500))
    bucket.refuses = True
    stage.upload.start()
    deadline = time.monotonic() + 30
    while not logged() and time.monotonic() < deadline:
        time.sleep(0.01)

    bucket.refuses = False
    stage.upload.finish(30.0)

    assert "could not be uploaded: Nothing answers." in logged()
    assert bucket.copy_of() == lines(0, 500)


def test_a_new_training_uploads_its_log_from_the_beginning(bucket, tmp_path):
    stage = Stage(tmp_path, lambda: bucket)
    stage.log("sim-0").write_text(lines(0, 500))
    LogCopy(bucket, KEY, stage.log("sim-0"), MAX_BYTES).update()

    begin_logs(tmp_path, stage.settings.model_prefix, stage.settings.log_max_mb)
    fresh = Counting()
    stage.log("sim-0").write_text("begins\n")
    LogCopy(fresh, KEY, stage.log("sim-0"), MAX_BYTES).update()

    assert fresh.copy_of() == "begins\n"


def test_prints_and_json_lines_are_uploaded_too(bucket, tmp_path):
    stage = Stage(tmp_path, lambda: bucket, "DR_LOG_JSON=True\n")
    stage.log("sim-0").write_text("one\n")
    stage.log("reward-0").write_text("printed\n")
    json_log(stage.log("trainer")).write_text("{}\n")

    stage.upload.start()
    stage.upload.finish(5.0)

    assert [info.key for info in bucket.list("model/logs/")] == [
        "model/logs/reward/reward-0.log",
        "model/logs/robomaker/sim-0.log",
        "model/logs/sagemaker/trainer.jsonl",
    ]


def test_a_new_training_sets_prints_and_json_lines_aside(tmp_path):
    stage = Stage(tmp_path, MemoryBucket)
    for path in (stage.log("reward-0"), json_log(stage.log("sim-0"))):
        path.write_text("of the training before\n")
        path.with_name(f"{path.name}.sent").write_text("{}")

    begin_logs(tmp_path, stage.settings.model_prefix, stage.settings.log_max_mb)

    left = sorted(path.name for path in (tmp_path / "data" / "logs").rglob("*") if path.is_file())
    assert [name.rpartition(".")[0] for name in left] == ["reward-0.log", "sim-0.jsonl"]


def test_what_another_machine_wrote_meanwhile_stays_when_the_first_goes_on(bucket, log, tmp_path):
    log.write_text(lines(0, 200))  # of which parts are noted
    LogCopy(bucket, KEY, log, MAX_BYTES).update()
    there = tmp_path / "there" / "sim-0.log"
    there.parent.mkdir()
    there.write_text("".join(f"elsewhere {k}\n" for k in range(10)))
    LogCopy(bucket, KEY, there, MAX_BYTES).update()

    with log.open("a") as file:
        file.write(lines(200, 205))
    LogCopy(bucket, KEY, log, MAX_BYTES).update()

    said = bucket.copy_of().splitlines()
    assert [line for line in said if line.startswith("elsewhere")] == there.read_text().splitlines()
    assert said[-5:] == lines(200, 205).splitlines()


def test_an_evaluation_begins_its_log_its_json_lines_and_its_prints_anew(tmp_path):
    log = log_file(tmp_path, "model", "evaluation")
    prints = log_file(tmp_path, "model", "reward-evaluation")
    older = [path.with_name(f"{path.name}.part-0001") for path in (log, json_log(log), prints)]
    other = log_file(tmp_path, "model", "trainer")
    for path in (log, json_log(log), prints, *older, other):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("earlier\n")

    empty_logs(tmp_path, "model", "evaluation")

    assert log.read_text() == ""
    assert not any(path.exists() for path in (json_log(log), prints, *older))
    assert other.read_text() == "earlier\n"


def test_the_first_evaluation_has_no_log_to_empty(tmp_path):
    empty_logs(tmp_path, "model", "evaluation")

    assert list(tmp_path.iterdir()) == []
