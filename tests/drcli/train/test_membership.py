"""A worker that has joined keeps its place, and notices the end of the training."""

import os
import threading
from dataclasses import replace

import pytest

from drcli.base.errors import OwnershipLost
from drcli.model import keys
from drcli.model.lease import STALE_S, write_lease
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName
from drcli.records.job import MemberRecord, Shares, SharesRecord, WorkerShare
from drcli.records.run_record import Lease
from drcli.train import membership as module
from drcli.train.membership import Membership
from drcli.workers.worker_process import StopRequested, StopSignal
from memory_bucket import MemoryBucket

PREFIX, NAME = "model", "joined-far-1"
LEASE = Lease("now", "host", 7, 0.0, term=1)


class Away:
    """A worker on another machine."""

    def __init__(self) -> None:
        self.age_s = 0.0
        self.bucket = MemoryBucket()
        write_lease(ModelStore(self.bucket, PREFIX), LEASE)
        self.stop_signal = StopSignal(os.getppid())
        self.written = threading.Event()
        watched = self.bucket.fenced(self._note)
        self.membership = Membership(
            ModelStore(watched, PREFIX), "now", NAME, self.stop_signal, pause=lambda _: None
        )

    def _note(self, key: str) -> None:
        if key == keys.member(PREFIX, NAME):
            self.written.set()

    def record(self) -> MemberRecord:
        return MemberRecord.decode(self.bucket.get(keys.member(PREFIX, NAME)))

    def next_record(self) -> MemberRecord:
        before = self.record().beat
        self.written.clear()
        while self.record().beat == before:
            assert self.written.wait(20.0)
        return self.record()

    def share(self, *workers: WorkerShare, session: str = "now") -> None:
        numbers = {share.member: share.worker for share in workers}
        record = SharesRecord(session, numbers, (Shares(1, 4, 4, workers),))
        self.bucket.put(keys.shares(PREFIX), record.encode())


def point_to(bucket: MemoryBucket, checkpoint: int) -> None:
    bucket.put(keys.coach_checkpoint(PREFIX), f"{checkpoint}_Step-9.ckpt".encode())


@pytest.fixture
def away(monkeypatch):
    monkeypatch.setattr(module, "RENEWED_S", 0.01)
    monkeypatch.setattr(module, "ASK_S", 0.0)
    found = Away()
    yield found
    found.membership.close()


def test_a_worker_announces_itself_and_says_when_it_is_ready(away):
    first = away.record()
    away.membership.is_ready(3)
    later = away.next_record()

    assert (first.member, first.session, first.ready) == (NAME, "now", False)
    assert (later.ready, later.checkpoint) == (True, 3)


def test_a_worker_says_how_far_it_is_and_notices_that_the_trainer_has_gone_on(away):
    away.membership.begin_drive(4, lambda: 30)
    away.membership.begin_drive(5, iter(range(100, 10_000)).__next__)
    away.next_record()
    driving = away.next_record()
    point_to(away.bucket, 5)
    away.next_record()
    away.next_record()
    needed = not away.membership.is_drive_over()
    point_to(away.bucket, 6)
    away.next_record()
    away.next_record()
    over = away.membership.is_drive_over()
    away.membership.end_drive()
    away.next_record()
    idle = away.next_record()

    assert driving.drives == 5
    assert 0 < driving.steps < 50
    assert driving.drive_s >= 0.0
    assert (needed, over) == (True, True)
    assert (idle.drives, idle.steps, idle.drive_s) == (-1, 0, 0.0)
    assert not away.membership.is_drive_over()


def test_it_leaves_without_a_trace(away):
    away.membership.close()

    assert not away.bucket.list(keys.members_folder(PREFIX))


def test_a_failure_stays_for_the_trainer_to_read(away):
    away.membership.close("the reward is None")
    away.membership.close()

    assert away.record().failure == "the reward is None"


def test_the_trainer_gives_it_a_number_and_a_share(away):
    away.share(WorkerShare(2, NAME, 8, 4), session="before")
    assert away.membership.shares_of(5) is None

    away.share(WorkerShare(2, NAME, 8, 4))

    assert away.membership.wait_for_number() == 2
    assert away.membership.shares_of(3) is None
    assert away.membership.shares_of(5).of(2).count == 4
    assert away.membership.is_reassigned(CheckpointName(4, 0))
    assert not away.membership.is_reassigned(CheckpointName(3, 0))


def test_a_worker_whose_share_has_ended_does_not_drive_the_open_iteration_again(away):
    own = Shares(1, 2, 4, (WorkerShare(2, NAME, 8, 4),))
    without = Shares(2, 4, 6, (WorkerShare(0, "", 8, 8),))
    record = SharesRecord("now", {NAME: 2}, (own, without))
    away.bucket.put(keys.shares(PREFIX), record.encode())

    # It has driven the iterations 4 and 5, and has found nothing to drive in 6.
    assert away.membership.shares_of(5).of(2) is not None
    assert not away.membership.is_reassigned(CheckpointName(5, 0))


@pytest.mark.parametrize(
    ("lease", "reason"),
    [
        (replace(LEASE, released=True), "it was ended"),
        (replace(LEASE, session="later", term=2), "another start continues it"),
    ],
)
def test_it_ends_with_the_training(away, lease, reason):
    write_lease(ModelStore(away.bucket, PREFIX), lease)

    with pytest.raises(StopRequested):
        away.membership.wait_for_number()

    assert away.stop_signal.ended == reason
    assert away.stop_signal.should_stop()


def test_it_notices_that_the_machine_of_the_training_is_gone(away, monkeypatch):
    old = replace(LEASE, age_s=STALE_S + 1.0)
    monkeypatch.setattr(module, "read_lease", lambda *_: old)

    with pytest.raises(StopRequested):
        away.membership.wait_for_number()

    assert away.stop_signal.ended == "its machine was not heard from for 61 s"


def test_a_lost_lease_ends_it_too(away):
    def refuse(_key: str) -> None:
        raise OwnershipLost("lost", remedy="none")

    away.membership._bucket = away.bucket.fenced(refuse)

    with pytest.raises(StopRequested):
        away.membership.wait_for_number()

    assert away.stop_signal.ended


def test_a_worker_that_hangs_no_longer_renews_its_record(away, monkeypatch):
    away.next_record()
    monkeypatch.setattr(module, "STUCK_S", -1.0)
    looks = threading.Semaphore(0)
    real = module.read_lease

    def look(*words):
        looks.release()
        return real(*words)

    monkeypatch.setattr(module, "read_lease", look)
    for _ in range(2):  # one may have begun before
        assert looks.acquire(timeout=20.0)
    before = away.record().beat
    for _ in range(3):
        assert looks.acquire(timeout=20.0)

    assert away.record().beat == before
