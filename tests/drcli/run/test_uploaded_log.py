"""The copy of a log in the bucket, as a machine reads it that has not written it."""

from datetime import UTC, datetime, timedelta

import pytest

from drcli.base.errors import StorageError
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.run_record import log_file
from drcli.run import read_logs, run_logs
from drcli.run.read_logs import UploadedTail, find_uploaded
from drcli.run.run_logs import LogCopy
from memory_bucket import MemoryBucket

KEY = "model/logs/robomaker/sim-0.log"


def lines(first, last):
    return b"".join(b"line %d\n" % k for k in range(first, last))


@pytest.fixture
def bucket():
    return MemoryBucket()


def put(bucket, *parts, newest):
    for number, data in enumerate(parts, 1):
        bucket.put(keys.part(KEY, number), data)
    bucket.put(KEY, newest)


def found(bucket):
    return find_uploaded(ModelStore(bucket, "model"), "sim-0", "sim-0.log")


def test_a_log_that_was_uploaded_is_read_as_it_was_written(bucket, tmp_path, monkeypatch):
    monkeypatch.setattr(run_logs, "PART_BYTES", 100)
    log = log_file(tmp_path, "model", "sim-0")
    log.parent.mkdir(parents=True)
    log.write_bytes(lines(0, 50))
    LogCopy(bucket, KEY, log, 1 << 20).update()

    copy = found(bucket)

    assert b"".join(copy.pieces()) == lines(0, 50)
    assert len(copy.objects) > 3


def test_nothing_is_found_of_another_log_of_the_same_folder(bucket):
    bucket.put("model/logs/robomaker/sim-01.log", b"x\n")
    bucket.put("model/logs/robomaker/sim-0.jsonl", b"x\n")
    bucket.put("model/logs/robomaker/sim-0.log.part-x", b"x\n")

    assert found(bucket) is None


def test_the_last_lines_take_no_more_objects_than_they_need(bucket):
    put(bucket, lines(0, 5), lines(5, 10), newest=lines(10, 12))
    bucket.delete([keys.part(KEY, 1)])
    copy, read = found(bucket), []
    get = bucket.get
    bucket.get = lambda key: read.append(key) or get(key)

    assert copy.last_lines(4) == lines(8, 12)
    assert read == [KEY, keys.part(KEY, 2)]
    assert copy.last_lines(0) == b""
    assert copy.last_lines(100) == lines(5, 12)


def test_a_part_that_is_deleted_meanwhile_is_left_out(bucket):
    put(bucket, lines(0, 5), newest=lines(5, 6))
    copy = found(bucket)
    bucket.delete([keys.part(KEY, 1)])

    assert b"".join(copy.pieces()) == lines(5, 6)


def test_parts_from_before_a_time_are_not_read(bucket):
    clock = [1_000.0]
    bucket = MemoryBucket(clock=lambda: clock[0])
    bucket.put(keys.part(KEY, 1), lines(0, 5))
    clock[0] = 2_000.0
    bucket.put(KEY, lines(5, 6))
    began = datetime.fromtimestamp(1_500.0, UTC)

    assert b"".join(found(bucket).pieces(began)) == lines(5, 6)
    assert b"".join(found(bucket).pieces(began + timedelta(days=1))) == b""
    assert found(bucket).uploaded == datetime.fromtimestamp(2_000.0, UTC)


@pytest.mark.parametrize("shown", [lines(0, 12), lines(9, 12), b""])
def test_what_is_uploaded_later_is_read_once(bucket, shown):
    put(bucket, lines(0, 5), lines(5, 10), newest=lines(10, 12))
    tail = UploadedTail(bucket, KEY, shown)
    already = b"" if shown else lines(0, 12)
    assert tail.read() == already

    bucket.put(KEY, lines(10, 14))
    assert tail.read() == lines(12, 14)
    bucket.put(keys.part(KEY, 3), lines(10, 16))
    bucket.put(KEY, lines(16, 17))
    assert tail.read() == lines(14, 17)
    assert tail.read() == b""


def test_a_training_that_begins_anew_is_followed_from_its_beginning(bucket):
    put(bucket, lines(0, 5), newest=lines(5, 6))
    tail = UploadedTail(bucket, KEY, lines(0, 6))
    bucket.delete([KEY, keys.part(KEY, 1)])
    assert tail.read() == b""

    bucket.put(KEY, lines(100, 102))

    assert tail.read() == lines(100, 102)


def test_a_copy_of_which_only_the_end_came_in_time_is_followed_when_the_rest_comes(
    bucket, monkeypatch
):
    monkeypatch.setattr(read_logs, "_KNOWN_BYTES", len(lines(20, 22)))
    put(bucket, lines(0, 5), newest=lines(20, 22))  # as at the end of a training
    tail = UploadedTail(bucket, KEY, lines(0, 5) + lines(20, 22))

    put(bucket, lines(0, 5), lines(5, 22), newest=lines(22, 23))

    assert tail.read() == lines(22, 23)


def test_a_bucket_that_does_not_answer_is_no_end(bucket):
    put(bucket, newest=lines(0, 2))
    tail = UploadedTail(bucket, KEY, lines(0, 2))
    listing = bucket.list
    bucket.list = lambda folder: (_ for _ in ()).throw(StorageError("No.", remedy="x"))
    with pytest.raises(StorageError):
        tail.read()
    bucket.list = listing
    bucket.put(KEY, lines(0, 3))

    assert tail.read() == lines(2, 3)
