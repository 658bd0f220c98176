"""How long a start waits for a model that somebody else has."""

import os
from dataclasses import replace

import pytest

from drcli.base.errors import SettingsError, StorageError, TrainedElsewhere
from drcli.base.processes import started_s
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.records.run_record import Lease, RunRecord, WaitingStart
from drcli.run.take_model import OwnerWait
from memory_bucket import MemoryBucket


class Time:
    """The clock of the bucket's server; pauses let it run, and let things happen."""

    def __init__(self) -> None:
        self.now = 1_000_000.0
        self.events: list[tuple[float, object]] = []

    def __call__(self) -> float:
        return self.now

    def pause(self, seconds: float) -> None:
        self.now += seconds
        while self.events and self.events[0][0] <= self.now:
            self.events.pop(0)[1]()


@pytest.fixture
def time():
    return Time()


@pytest.fixture
def bucket(time):
    return MemoryBucket(clock=time)


@pytest.fixture
def said(monkeypatch):
    lines: list[str] = []
    monkeypatch.setattr("drcli.base.errors.show", lines.append)
    monkeypatch.setattr("drcli.base.errors.warn", lines.append)
    return lines


@pytest.fixture
def waiting(bucket, time, said, tmp_path):
    def make(*, wait=True):
        return OwnerWait(ModelStore(bucket, "model"), tmp_path, wait, pause=time.pause)

    return make


THEIRS = Lease("theirs", "elsewhere", 77, 0.0, machine="another", term=3)


def test_nobody_is_waited_for(waiting, time, said):
    began = time.now

    waiting().until_free()

    assert (time.now, said) == (began, [])


def test_the_lease_of_a_dead_machine_expires_within_a_minute_and_that_is_said_once(
    waiting, bucket, time, said
):
    lease.write_lease(ModelStore(bucket, "model"), THEIRS)
    began = time.now

    waiting(wait=False).until_free()

    assert 58.0 <= time.now - began <= 63.0
    assert len(said) == 1
    assert "process 77 on elsewhere, last heard from 0 s ago. Waiting up to 60 s" in said[0]


def renewing(bucket, time, until_s):
    """An owner elsewhere that renews its lease until then, and releases it."""

    def renew():
        if time.now >= until_s:
            lease.write_lease(
                ModelStore(bucket, "model"), replace(THEIRS, renewed=time.now, released=True)
            )
            return
        lease.write_lease(ModelStore(bucket, "model"), replace(THEIRS, renewed=time.now))
        time.events.append((time.now + 10.0, renew))

    renew()


def test_a_living_owner_is_waited_for_until_it_ends(waiting, bucket, time, said):
    began = time.now
    renewing(bucket, time, began + 3600.0)

    waiting().until_free()

    assert 3600.0 <= time.now - began <= 3625.0
    assert len(said) == 2
    assert "Waiting until that training ends" in said[1]


def test_without_waiting_a_living_owner_is_known_within_seconds(waiting, bucket, time):
    began = time.now
    renewing(bucket, time, began + 3600.0)

    with pytest.raises(TrainedElsewhere, match="process 77 on elsewhere"):
        waiting(wait=False).until_free()

    assert time.now - began <= 14.0


def test_an_owner_on_this_machine_is_known_to_live_at_once(waiting, bucket, time, said):
    began = time.now
    lease.take(ModelStore(bucket, "model"), "a start here")

    with pytest.raises(TrainedElsewhere):
        waiting(wait=False).until_free()

    assert (time.now, said) == (began, [])


def test_a_start_here_that_has_no_lease_yet_counts_as_owner(waiting, tmp_path):
    own = os.getpid()
    RunRecord(0, "s", "bucket", "model", "oval", "starting", own, started_s(own) or 0.0, 1.0).write(
        tmp_path
    )

    with pytest.raises(TrainedElsewhere):
        waiting(wait=False).until_free()


def test_an_outage_of_the_bucket_does_not_end_the_waiting(waiting, bucket, time, said, monkeypatch):
    renewing(bucket, time, time.now + 100.0)
    down = False

    def go_down():
        nonlocal down
        down = True
        time.events.insert(0, (time.now + 40.0, go_up))

    def go_up():
        nonlocal down
        down = False

    time.events.append((time.now + 15.0, go_down))
    time.events.sort(key=lambda event: event[0])
    get = MemoryBucket.get_with_age

    def read(self, key):
        if down:
            raise StorageError("The bucket is away.", remedy="")
        return get(self, key)

    monkeypatch.setattr(MemoryBucket, "get_with_age", read)

    waiting().until_free()

    assert said.count("The bucket is away. Waiting goes on.") == 1


def test_a_newer_drcli_is_not_waited_for(waiting, bucket):
    bucket.put(keys.lease("model"), b'{"format": 99}')

    with pytest.raises(SettingsError, match="newer version"):
        waiting().until_free()


def test_those_that_wait_can_be_found_and_leave_nothing_behind(waiting, bucket, time, tmp_path):
    lease.write_lease(ModelStore(bucket, "model"), THEIRS)
    found: list[WaitingStart] = []
    time.events.append((time.now + 5.0, lambda: found.extend(WaitingStart.all(tmp_path))))

    waiting().until_free()

    assert [one.pid for one in found] == [os.getpid()]
    assert WaitingStart.all(tmp_path) == []
    assert list(tmp_path.iterdir()) == []
