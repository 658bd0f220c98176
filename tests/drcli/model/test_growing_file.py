"""Whenever the writer dies, the object and its parts together have every entry that was stored."""

import json
import threading

import pytest

from drcli.base.errors import StorageError
from drcli.model.growing_file import SMALL_BYTES, GrowingFile, Layout, list_parts
from memory_bucket import MemoryBucket

KEY = "model/metrics/file.json"
LAYOUT = Layout(b"[", b", ", b"]")
LARGE = 3000
"""Bytes of an entry: fifty of them are more than a small object."""


class CountingBucket(MemoryBucket):
    """Counts what is written, and can refuse some keys."""

    def __init__(self) -> None:
        super().__init__()
        self.written: list[tuple[str, int]] = []
        self.refused = ""

    def put(self, key, data, *, watch=None):
        if key == self.refused:
            raise StorageError("The disk is full.", remedy="Delete something.")
        self.written.append((key, len(data)))
        super().put(key, data, watch=watch)


@pytest.fixture
def bucket() -> CountingBucket:
    return CountingBucket()


@pytest.fixture
def now_s() -> list[float]:
    return [0.0]


@pytest.fixture
def file(bucket, now_s) -> GrowingFile:
    return GrowingFile(bucket, KEY, LAYOUT, iterations_per_part=8, clock=lambda: now_s[0])


def entry(iteration: int, size: int = LARGE, mark: str = "a") -> bytes:
    return json.dumps([iteration, mark * size]).encode()


def grow(file: GrowingFile, first: int, end: int) -> None:
    for iteration in range(first, end):
        file.put(iteration, entry(iteration))


def stored(bucket: MemoryBucket) -> dict[int, str]:
    """First letter of each entry by iteration, as a reader finds them who knows no writer."""
    parts = [json.loads(bucket.get(key)) for key in list_parts(bucket, KEY)]
    whole = json.loads(bucket.get(KEY)) if bucket.exists(KEY) else []
    return {iteration: text[0] for each in (whole, *parts) for iteration, text in each}


def test_a_small_object_is_one_object_that_is_always_complete(bucket, file):
    for iteration in range(20):
        file.put(iteration, entry(iteration, size=10))

        assert [n for n, _ in json.loads(bucket.get(KEY))] == list(range(iteration + 1))
        assert not list_parts(bucket, KEY)


def test_each_entry_is_stored_when_put_returns(bucket, file):
    for iteration in range(100):
        file.put(iteration, entry(iteration))

        assert sorted(stored(bucket)) == list(range(iteration + 1))


def test_what_an_entry_costs_does_not_grow_with_their_number(bucket, file, now_s):
    grow(file, 0, 400)
    early = len(bucket.written)
    now_s[0] = -1.0  # the whole object is not due again
    grow(file, 400, 500)

    # The thread that writes the whole object may end only now.
    sizes = [size for key, size in bucket.written[early:] if key != KEY]
    assert len(sizes) == 100
    assert max(sizes) < 8 * (LARGE + 20)


def test_the_whole_object_is_written_now_and_then_and_replaces_its_parts(bucket, file, now_s):
    grow(file, 0, 60)
    while json.loads(bucket.get(KEY))[-1][0] != 70:
        now_s[0] += 1000.0
        file.put(70, entry(70))

    file.write()

    assert not list_parts(bucket, KEY)
    assert sorted(stored(bucket)) == [*range(60), 70]


def test_an_entry_that_changes_while_the_whole_object_is_written_keeps_its_part(bucket, now_s):
    began, go_on, written = (threading.Event() for _ in range(3))

    class SlowBucket(CountingBucket):
        def put(self, key, data, *, watch=None):
            slow = key == KEY and len(data) > SMALL_BYTES
            if slow:
                began.set()
                assert go_on.wait(10.0)
            super().put(key, data, watch=watch)
            if slow:
                written.set()

    bucket = SlowBucket()
    file = GrowingFile(bucket, KEY, LAYOUT, iterations_per_part=8, clock=lambda: now_s[0])
    grow(file, 0, 50)
    assert began.wait(10.0)
    file.put(49, entry(49, mark="z"))
    go_on.set()
    assert written.wait(10.0)
    for _ in range(20):  # one of these deletes the parts that the whole object has
        file.put(48, entry(48))
        assert stored(bucket)[49] == "z"


def test_when_the_whole_object_cannot_be_written_nothing_is_lost_and_the_log_says_it(
    bucket, file, logged, now_s
):
    grow(file, 0, 43)
    bucket.refused = KEY
    now_s[0] = 1000.0
    grow(file, 43, 60)
    file.finish()

    assert sorted(stored(bucket)) == list(range(60))
    assert "is not complete: The disk is full." in logged()


def test_at_the_end_one_object_has_everything(bucket, file):
    grow(file, 0, 90)

    file.finish()

    assert not list_parts(bucket, KEY)
    assert [n for n, _ in json.loads(bucket.get(KEY))] == list(range(90))


@pytest.mark.parametrize("first", [0, 16, 50, 57, 89])
def test_dropped_entries_are_gone_from_the_bucket_and_others_stay(bucket, file, first):
    grow(file, 0, 90)

    file.drop_from(first)
    file.put(first, entry(first, mark="n"))

    assert sorted(stored(bucket)) == list(range(first + 1))
    assert stored(bucket)[first] == "n"
    file.finish()
    assert sorted(stored(bucket)) == list(range(first + 1))


def test_the_next_process_continues_where_the_last_one_died(bucket, file):
    grow(file, 0, 70)
    found = stored(bucket)

    second = GrowingFile(bucket, KEY, LAYOUT, iterations_per_part=8)
    second.restore(((n, entry(n)) for n in sorted(found)), list_parts(bucket, KEY))
    grow(second, 70, 75)
    second.finish()

    assert [n for n, _ in json.loads(bucket.get(KEY))] == list(range(75))
    assert not list_parts(bucket, KEY)


def test_entries_of_long_ago_can_be_read_and_changed(bucket, file):
    grow(file, 0, 90)

    assert file.entry(3) == entry(3)
    assert file.entry(500) is None
    file.put(3, entry(3, mark="c"))

    assert stored(bucket)[3] == "c"
    file.finish()
    assert stored(bucket) == {n: "c" if n == 3 else "a" for n in range(90)}
