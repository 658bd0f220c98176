"""Traces stay within their limits, and what is left still shows the whole training."""

from itertools import pairwise

import pytest

from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.model.traces import MOST_ITERATIONS, NEWEST, TraceRetention, chosen
from memory_bucket import MemoryBucket

KB = 1000


def drive(bucket: MemoryBucket, iterations: range, workers: int = 1) -> None:
    for iteration in iterations:
        for worker in range(workers):
            key = keys.training_trace("model", iteration, worker=worker, workers=workers)
            bucket.put(key, b"x" * KB)


def left(bucket: MemoryBucket) -> list[int]:
    folder = "model/training-simtrace/"
    names = [info.key.removeprefix(folder) for info in bucket.list(folder)]
    return sorted(int(name.partition("-")[0]) for name in names)


def test_below_the_limit_every_trace_stays():
    bucket = MemoryBucket()
    drive(bucket, range(100))

    assert TraceRetention(ModelStore(bucket, "model"), 1, 100 * KB).apply(99) is None
    assert left(bucket) == list(range(100))


def test_without_a_limit_every_trace_stays():
    bucket = MemoryBucket()
    drive(bucket, range(30))

    assert TraceRetention(ModelStore(bucket, "model"), 1, 0).apply(29) is None
    assert left(bucket) == list(range(30))


def test_of_a_long_training_the_first_and_the_newest_stay_and_the_others_evenly():
    bucket = MemoryBucket()
    retention = TraceRetention(ModelStore(bucket, "model"), 1, 100 * KB)
    for iteration in range(2000):
        drive(bucket, range(iteration, iteration + 1))
        retention.apply(iteration)

    kept = left(bucket)
    assert kept[0] == 0
    assert kept[-NEWEST:] == list(range(2000 - NEWEST, 2000))
    assert len(kept) <= 100
    older = [n for n in kept if n < 1900]
    gaps = [b - a for a, b in pairwise(older)]
    assert len(older) > 25
    assert max(gaps) <= 4 * min(gaps)


def test_the_limit_counts_the_traces_of_all_workers_and_takes_whole_iterations():
    bucket = MemoryBucket()
    drive(bucket, range(100), workers=3)

    thinned = TraceRetention(ModelStore(bucket, "model"), 3, 150 * KB).apply(99)

    assert thinned is not None
    assert thinned.left * 3 <= 150
    kept = [{info.key.rpartition("/")[2] for info in bucket.list(f"model/{k}/")} for k in range(3)]
    assert kept[0] == kept[1] == kept[2]
    assert len(kept[0]) == thinned.left


def test_small_traces_are_limited_by_their_number():
    sizes = dict.fromkeys(range(MOST_ITERATIONS + 1), 1)

    doomed = chosen(sizes, MOST_ITERATIONS, 10**9, MOST_ITERATIONS)

    assert len(sizes) - len(doomed) == MOST_ITERATIONS * 9 // 10
    assert all(iteration % 2 for iteration in doomed)


@pytest.mark.parametrize("max_bytes", [1, 5 * KB])
def test_a_limit_below_the_newest_traces_keeps_these(max_bytes):
    sizes = dict.fromkeys(range(50), KB)

    doomed = chosen(sizes, 49, max_bytes, MOST_ITERATIONS)

    assert sorted(sizes.keys() - doomed) == [0, *range(50 - NEWEST, 50)]


def test_far_below_the_limit_the_bucket_is_hardly_asked(monkeypatch):
    bucket = MemoryBucket()
    drive(bucket, range(5))
    asked = []
    real = bucket.list
    monkeypatch.setattr(bucket, "list", lambda folder: asked.append(folder) or real(folder))
    retention = TraceRetention(ModelStore(bucket, "model"), 1, 10**9)

    for iteration in range(5, 505):
        retention.apply(iteration)

    assert len(asked) <= 6


def test_traces_of_those_who_joined_and_of_the_first_worker_beside_them_count():
    bucket = MemoryBucket()
    drive(bucket, range(20))
    drive(bucket, range(20, 40), workers=3)
    retention = TraceRetention(ModelStore(bucket, "model"), 1, 0)

    retention.cover(2)
    retention.cover(1)

    assert retention.delete_after(9) == 10 + 3 * 20
