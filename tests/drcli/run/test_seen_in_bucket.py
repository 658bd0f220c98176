"""What a page of another machine shows: who trains, what the workers do, where the cars drove."""

import time

import pytest

from drcli.model import keys
from drcli.model.lease import write_lease
from drcli.model.model_store import ModelStore
from drcli.records.run_record import ActivityRecord, Lease
from drcli.records.trace import CSV_HEADER
from drcli.run.seen_in_bucket import MOST_LINES, SeenRun, distant_run, lap_lines, read_lap_lines
from memory_bucket import MemoryBucket


def row(episode, step, x, *, progress=1.0, status="in_progress"):
    return (
        f"{episode},{step},{x},2.004,0,0,1,0,1.0,False,True,{progress},1,17.7,{step / 15},"
        f"{status},0,0,{step},0.1"
    )


def trace(*rows):
    return "\n".join([CSV_HEADER, *rows, ""]).encode()


@pytest.fixture
def run():
    bucket = MemoryBucket()
    return SeenRun(
        ModelStore(bucket, "model", "model/metrics"), "model", "reinvent_base", alive=False
    )


def test_a_training_on_another_machine_is_told_with_its_workers(run):
    now, bucket = time.time(), run.model.bucket
    write_lease(ModelStore(bucket, "model"), Lease("s", "tower", 7, now, machine="another"))
    for name in ("sim-1", "trainer", "sim-0"):
        does = ActivityRecord(f"{name} drives", now, 8, "tower")
        bucket.put(keys.status("model", name), does.encode())
    bucket.put(keys.status("model", "sim-2"), b"{")

    found = distant_run(run)

    assert found.host == "tower"
    assert [worker.name for worker in found.workers] == ["trainer", "sim-0", "sim-1"]
    assert found.workers[1].activity == "sim-0 drives"


def test_nobody_trains_after_the_end_or_without_a_bucket(run):
    assert distant_run(run).host is None
    lease = Lease("s", "tower", 7, time.time(), machine="another", released=True)
    write_lease(ModelStore(run.model.bucket, "model"), lease)
    assert distant_run(run).host is None
    assert distant_run(SeenRun(None, "model", "bean", alive=False)).world == "bean"


def test_lines_are_those_of_the_newest_episodes_with_their_ends():
    rows = [row(e, s, e + s / 100, progress=s / 4) for e in range(30) for s in range(401)]
    lines = lap_lines(trace(*rows, "broken,row", row(29, 401, "nan")))

    assert len(lines) == MOST_LINES
    assert lines[-1].x[0] == 29.0
    assert lines[-1].x[-1] == 33.0
    assert lines[-1].y[0] == 2.0
    assert len(lines[-1].x) <= 161
    assert (lines[-1].progress, lines[-1].status) == (100.0, "in_progress")


def test_each_worker_has_its_trace_also_where_there_are_several(run):
    bucket = run.model.bucket
    one, many = trace(row(0, 0, 1.0), row(0, 1, 1.5)), trace(row(0, 0, 5.0), row(0, 1, 5.5))
    bucket.put(keys.training_trace("model", 3), one)
    assert read_lap_lines(ModelStore(bucket, "model"), 3, 0)[0].x == [1.0, 1.5]
    assert read_lap_lines(ModelStore(bucket, "model"), 3, 1) == []
    bucket.put(keys.training_trace("model", 4, worker=1, workers=2), many)
    assert read_lap_lines(ModelStore(bucket, "model"), 4, 1)[0].x == [5.0, 5.5]


@pytest.mark.parametrize("data", [b"", b"\0\0", b"a,b\n1,2\n", CSV_HEADER.encode()])
def test_what_is_no_trace_has_no_lines(data):
    assert lap_lines(data) == []
