"""A measured bucket gets little traffic, and is as it was (seeds 001-10)."""

import time

import pytest

from drcli.base.errors import StorageError
from drcli.checks.bench import bucket_speed
from drcli.checks.bench.bucket_speed import measure_bucket
from memory_bucket import MemoryBucket


class CountingBucket(MemoryBucket):
    """Counts the bytes that it gets; fails at the object with a given number."""

    def __init__(self, fails_at: int = -1) -> None:
        super().__init__()
        self.sent: list[int] = []
        self._fails_at = fails_at

    def put(self, key, data, *, watch=None):
        self.sent.append(len(data))
        if len(self.sent) == self._fails_at:
            raise StorageError("The server is away.", remedy="Wait.")
        super().put(key, data, watch=watch)


def test_it_counts_what_it_sends_and_leaves_nothing():
    bucket = CountingBucket()
    bucket.put("model/pointer", b"mine")
    bucket.sent.clear()

    found = measure_bucket(bucket, 30.0)

    assert [info.key for info in bucket.list("")] == ["model/pointer"]
    assert sum(bucket.sent) == found.sent_bytes <= bucket_speed.MOST_BYTES + (1 << 18)
    assert found.requests >= 2 * len(bucket.sent)
    assert found.put_mb_per_s > 0.0
    assert found.requests_per_s == pytest.approx(1000 / found.request_ms, rel=20)


def test_a_slow_bucket_gets_one_large_object_and_few_requests(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(bucket_speed.time, "perf_counter", lambda: now[0])

    class SlowBucket(CountingBucket):
        def put(self, key, data, *, watch=None):
            now[0] += 0.5 + len(data) / 100_000
            super().put(key, data, watch=watch)

    bucket = SlowBucket()
    found = measure_bucket(bucket, 6.0)

    assert bucket.sent.count(1 << 18) == 1
    assert max(bucket.sent) == 1 << 18
    assert now[0] < 10.0
    assert found.put_mb_per_s == pytest.approx((1 << 18) / (0.5 + (1 << 18) / 1e5) / 1e6)


def test_a_failure_leaves_nothing_either():
    bucket = CountingBucket(fails_at=4)

    with pytest.raises(StorageError):
        measure_bucket(bucket, 1.0)

    assert bucket.list("") == []


def test_leftovers_of_killed_measurements_go_after_an_hour():
    now = [time.time() - 4000.0]
    bucket = MemoryBucket(clock=lambda: now[0])
    bucket.put(".drcli-test-bench/old/1", b"x")
    now[0] = time.time()
    bucket.put(".drcli-test-bench/new/1", b"x")

    measure_bucket(bucket, 0.1)

    assert [info.key for info in bucket.list("")] == [".drcli-test-bench/new/1"]
