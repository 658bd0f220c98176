"""Event files in the bucket: each once, bounded, and back on another machine."""

import pytest

from drcli.base.errors import StorageError
from drcli.config.loading import load_settings
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.run import run_logs, tensorboard_server
from drcli.run.run_logs import LogUpload
from drcli.run.timed_uploads import EventFileCopies, fetch_event_files
from memory_bucket import MemoryBucket

FIRST, SECOND, THIRD = (
    f"events.out.tfevents.{1_700_000_000 + k}.000000.host.7.1" for k in range(3)
)
MADE_HERE = "events.out.tfevents.1700000000.500000.host.9.1.history"
MOST = 1000


class Counting(MemoryBucket):
    """A bucket that keeps the keys that were written, and may refuse."""

    def __init__(self):
        super().__init__()
        self.written, self.refuses = [], False

    def put(self, key, data, *, watch=None):
        if self.refuses:
            raise StorageError("Nothing answers.", remedy="Wait.")
        self.written.append(key)
        super().put(key, data, watch=watch)

    def names(self, prefix="m"):
        folder = keys.event_folder(prefix)
        return sorted(info.key.removeprefix(folder) for info in self.list(folder))


@pytest.fixture
def bucket():
    return Counting()


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "data" / "tensorboard" / "m"
    made.mkdir(parents=True)
    return made


def test_only_files_that_have_grown_are_uploaded(bucket, folder):
    (folder / FIRST).write_bytes(b"abc")
    copies = EventFileCopies(ModelStore(bucket, "m"), folder, MOST)

    copies.update()
    copies.update()
    (folder / SECOND).write_bytes(b"de")
    assert copies.left_bytes() == 2
    copies.update()
    EventFileCopies(ModelStore(bucket, "m"), folder, MOST).update()  # a later start

    assert bucket.written == [keys.event_file("m", FIRST), keys.event_file("m", SECOND)]
    assert copies.left_bytes() == 0
    with (folder / SECOND).open("ab") as file:
        file.write(b"f")
    copies.update()
    assert bucket.get(keys.event_file("m", SECOND)) == b"def"


def test_the_oldest_files_go_when_there_is_too_much(bucket, folder):
    bucket.put(keys.event_file("m", FIRST), b"x" * 600)  # of a machine that is gone
    (folder / SECOND).write_bytes(b"x" * 600)
    (folder / THIRD).write_bytes(b"x" * 300)

    EventFileCopies(ModelStore(bucket, "m"), folder, MOST).update()

    assert bucket.names() == [SECOND, THIRD]


def test_in_a_hurry_the_newest_file_comes_first(bucket, folder):
    for name in (FIRST, SECOND):
        (folder / name).write_bytes(b"x")
    copies = EventFileCopies(ModelStore(bucket, "m"), folder, MOST)

    copies.update(lambda: bool(bucket.written), hurried=True)

    assert bucket.names() == [SECOND]
    assert copies.left_bytes() == 1


def test_a_training_uploads_them_with_its_logs_and_tries_again(
    bucket, folder, tmp_path, monkeypatch
):
    monkeypatch.setattr(run_logs, "INTERVAL_S", 3600.0)
    (tmp_path / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=m\n")
    settings = load_settings(tmp_path).run.logs
    (folder / FIRST).write_bytes(b"abc")
    bucket.refuses = True
    upload = LogUpload(lambda: bucket, tmp_path, "m", settings, ["trainer"], folder)
    upload._upload()
    bucket.refuses = False

    upload.start()
    upload.finish(10.0)

    assert bucket.get(keys.event_file("m", FIRST)) == b"abc"


def test_another_machine_gets_them_and_later_what_is_new(bucket, folder):
    bucket.put(keys.event_file("m", FIRST), b"abc")
    bucket.put(keys.event_folder("m") + "../../escape", b"x")
    bucket.put(keys.event_folder("m") + "notes.txt", b"x")

    assert fetch_event_files(ModelStore(bucket, "m"), folder, MOST)
    assert not fetch_event_files(ModelStore(bucket, "m"), folder, MOST)
    with (folder / FIRST).open("rb") as read_by_tensorboard:
        bucket.put(keys.event_file("m", FIRST), b"abcdef")
        bucket.put(keys.event_file("m", SECOND), b"g")
        assert fetch_event_files(ModelStore(bucket, "m"), folder, MOST)

        assert read_by_tensorboard.read() == b"abcdef"
    assert sorted(path.name for path in folder.iterdir()) == [FIRST, SECOND]


def test_what_a_training_writes_here_is_not_touched(bucket, folder):
    (folder / SECOND).write_bytes(b"longer than the copy")
    bucket.put(keys.event_file("m", SECOND), b"longer")
    bucket.put(keys.event_file("m", FIRST), b"of a machine that is gone")

    assert not fetch_event_files(ModelStore(bucket, "m"), folder, MOST)

    assert [path.name for path in folder.iterdir()] == [SECOND]


def test_real_files_replace_those_that_were_made_of_the_history(bucket, folder):
    (folder / MADE_HERE).write_bytes(b"from the history")
    assert not fetch_event_files(ModelStore(bucket, "m"), folder, MOST)
    assert (folder / MADE_HERE).exists()
    bucket.put(keys.event_file("m", FIRST), b"abc")

    assert fetch_event_files(ModelStore(bucket, "m"), folder, MOST)

    assert [path.name for path in folder.iterdir()] == [FIRST]


def test_files_that_are_too_large_together_are_left_out(bucket, folder):
    bucket.put(keys.event_file("m", FIRST), b"x" * 600)
    bucket.put(keys.event_file("m", SECOND), b"x" * 600)

    assert fetch_event_files(ModelStore(bucket, "m"), folder, MOST)

    assert [path.name for path in folder.iterdir()] == [SECOND]


def test_a_folder_that_cannot_be_written_is_a_clear_error(bucket, tmp_path):
    (tmp_path / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=m\n")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "tensorboard").write_text("a file")
    bucket.put(keys.event_file("m", FIRST), b"abc")

    with pytest.raises(Exception, match="cannot be written") as error:
        tensorboard_server.fetch_events(load_settings(tmp_path), bucket, ["m"])

    assert "has room" in error.value.remedy
