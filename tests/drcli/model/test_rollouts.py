"""Workers hand in, the trainer takes: only what a manifest confirms, and nobody waits unheard."""

import json
import threading

import numpy as np
import pytest

from drcli.base.errors import StorageError
from drcli.base.json_record import RecordError
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing
from drcli.learn.rollout_buffer import Rollout
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_prefix import delete_unlearned
from drcli.model.model_store import ModelStore
from drcli.model.training_state import MemberReader
from drcli.records.job import MemberRecord
from drcli.records.rollout import Driving, Episodes, Manifest
from drcli.train import rollouts
from drcli.train.rollouts import RolloutReader, RolloutWriter, find_manifest
from memory_bucket import MemoryBucket

PREFIX = "team/model-1"
CHECKPOINT = "3_Step-900.ckpt"


def played(steps: int, number: int = 0) -> Episodes:
    column = np.arange(steps, dtype=np.float64)
    return Episodes(
        Rollout(
            frames=np.full((steps, 1, 12, 16), number, np.uint8),
            actions=np.arange(steps),
            log_probs=column.astype(np.float32),
            values=column,
            rewards=column,
            lengths=np.array([steps]),
            last_values=np.zeros(1),
            cut=np.zeros(1, np.bool_),
            scans=np.zeros((steps, 0), np.float32),
            states=np.zeros((steps, 0), np.float32),
        ),
        numbers=np.array([number]),
        progress=np.array([50.0]),
        completed=np.array([False]),
        duration_s=np.array([2.0]),
    )


def writer(bucket, worker=0, *, session="s1", checkpoint=CHECKPOINT, iteration=3) -> RolloutWriter:
    return RolloutWriter(
        ModelStore(bucket, PREFIX), Manifest(iteration, worker, checkpoint, session)
    )


def hand_in(bucket, worker=0, **kind) -> Manifest:
    sending = writer(bucket, worker, **kind)
    sending.add(played(5, 10 * worker))
    sending.add(played(7, 10 * worker + 1))
    return sending.finish(Driving(2.5))


class Clock:
    """Time that passes only while somebody waits; things may happen meanwhile."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.happens = {}

    def __call__(self) -> float:
        return self.now_s

    def pause(self, seconds: float) -> None:
        assert seconds > 0
        self.now_s += seconds
        for due_s in [due_s for due_s in self.happens if due_s <= self.now_s]:
            self.happens.pop(due_s)()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def reader(memory, clock):
    reader = RolloutReader(ModelStore(memory, PREFIX), clock=clock, pause=clock.pause)
    yield reader
    reader.close()


def wait(reader, workers, *, patience_s=100.0, **kind):
    return reader.wait_manifests(
        3,
        [CHECKPOINT],
        workers,
        enough=len(workers),
        is_over=lambda arrived, waited_s: waited_s >= patience_s,
        **kind,
    )


def test_what_a_worker_played_arrives_part_by_part(bucket):
    reader = RolloutReader(ModelStore(bucket, PREFIX))
    manifest = hand_in(bucket)

    arrived = wait(reader, [0])
    episodes = reader.read([arrived[0]])
    reader.close()

    assert arrived == {0: manifest}
    assert (len(manifest.parts), manifest.steps, manifest.notes) == (2, 12, Driving(2.5))
    assert episodes.rollout.frames[:, 0, 0, 0].tolist() == [0] * 5 + [1] * 7


def test_a_manifest_comes_back_from_its_bytes(memory):
    manifest = hand_in(memory, 2)

    assert Manifest.decode(manifest.encode()) == manifest
    assert find_manifest(ModelStore(memory, PREFIX), 3, 2) == manifest
    assert find_manifest(ModelStore(memory, PREFIX), 4, 2) is None


@pytest.mark.parametrize("data", [b"", b"[]", b"{}", b'{"parts": [{}]}'])
def test_other_bytes_are_not_a_manifest(memory, data):
    memory.put(keys.rollout_manifest(PREFIX, 3, 0), data)

    with pytest.raises(RecordError, match=r"truncated|Expected `object`|missing required field"):
        Manifest.decode(data)
    assert find_manifest(ModelStore(memory, PREFIX), 3, 0) is None


def test_a_failed_upload_surfaces_at_the_end_and_nothing_counts():
    class FullBucket(MemoryBucket):
        def put(self, key: str, data: bytes) -> None:
            raise StorageError("The disk is full.", remedy="Make room.")

    bucket = FullBucket()
    sending = writer(bucket)
    sending.add(played(5))

    with pytest.raises(StorageError, match="disk is full"):
        sending.finish(Driving())

    assert find_manifest(ModelStore(bucket, PREFIX), 3, 0) is None


def test_an_abandoned_rollout_has_no_manifest(memory):
    sending = writer(memory)
    sending.add(played(5))

    sending.abandon()

    assert find_manifest(ModelStore(memory, PREFIX), 3, 0) is None


def test_a_restarted_worker_overwrites_no_part_of_its_former_self(memory, reader):
    before = hand_in(memory, session="one")
    after = hand_in(memory, session="two")

    assert not {part.key for part in before.parts} & {part.key for part in after.parts}
    assert wait(reader, [0])[0] == after


def test_a_manifest_of_another_checkpoint_counts_as_missing(memory, reader, clock):
    hand_in(memory, checkpoint="3_Step-880.ckpt", session="old")
    clock.happens[20.0] = lambda: hand_in(memory, session="new")

    arrived = wait(reader, [0])

    assert arrived[0].session == "new"
    assert 20.0 <= clock.now_s < 21.5


def test_a_manifest_of_another_start_counts_as_missing_and_its_parts_are_left(memory, clock):
    reader = RolloutReader(ModelStore(memory, PREFIX), "ours", clock=clock, pause=clock.pause)
    hand_in(memory, 0, session="theirs-7-1")
    hand_in(memory, 1, session="ours-7-1")

    arrived = wait(reader, [0, 1], patience_s=1.0)

    assert [m.session for m in arrived.values()] == ["ours-7-1"]
    assert all("ours-7-1" in key for key in reader._fetched)
    reader.close()


def test_the_wait_says_who_is_missing_and_goes_on_without(memory, reader, clock, monkeypatch):
    hand_in(memory, 1)
    said: list[str] = []
    monkeypatch.setattr(rollouts._logger, "info", lambda *words: said.append(words[0] % words[1:]))

    arrived = wait(reader, [0, 1, 2], patience_s=25.0)

    assert list(arrived) == [1]
    assert [sentence.endswith("worker 0, 2.") for sentence in said] == [True, True, False]
    assert clock.now_s == pytest.approx(25.0, abs=1.0)
    assert said[-1] == (
        f"The trainer has been waiting {clock.now_s:.0f} s for iteration 3 of simulation "
        "worker 0, 2; going on without."
    )


def test_a_stop_ends_the_wait(memory, reader, clock):
    assert wait(reader, [0], should_stop=lambda: clock.now_s > 5) == {}
    assert clock.now_s < 6


def test_parts_are_fetched_before_their_manifest_comes(memory, clock):
    asked: list[str] = []

    class WatchedBucket(MemoryBucket):
        def get(self, key: str) -> bytes:
            asked.append(f"{clock.now_s:.0f} {key.rpartition('/')[2]}")
            return super().get(key)

    bucket = WatchedBucket()
    reader = RolloutReader(ModelStore(bucket, PREFIX), clock=clock, pause=clock.pause)
    sending = writer(bucket)
    sending.add(played(5))
    sending._uploads[0].result()
    clock.happens[10.0] = lambda: sending.finish(Driving())

    manifest = wait(reader, [0])[0]
    reader.read([manifest])
    reader.close()

    assert asked[0] == "0 s1-0.safetensors"
    assert len([line for line in asked if line.endswith("s1-0.safetensors")]) == 1


def test_no_more_is_fetched_ahead_than_memory_allows(memory, reader, monkeypatch):
    monkeypatch.setattr(rollouts, "PREFETCH_BYTES", 0)
    manifest = hand_in(memory)

    wait(reader, [0])

    assert reader._fetched == {}
    assert reader.read([manifest]).count == 2


def test_a_part_that_its_manifest_does_not_confirm_is_refused(memory, reader):
    manifest = hand_in(memory)
    key = manifest.parts[1].key
    memory.put(key, memory.get(manifest.parts[0].key))

    with pytest.raises(ObjectDamaged, match=rf"{key} is damaged") as failure:
        reader.read([manifest])

    assert "worker 0 must drive iteration 3 again" in failure.value.remedy


def test_a_part_that_was_fetched_too_early_is_fetched_again(memory, reader):
    manifest = hand_in(memory)
    whole = memory.get(manifest.parts[0].key)
    memory.put(manifest.parts[0].key, whole[:50])
    wait(reader, [0])
    reader._fetched[manifest.parts[0].key].result()

    memory.put(manifest.parts[0].key, whole)

    assert reader.read([manifest]).count == 2


def test_a_part_that_is_gone_is_named(memory, reader):
    manifest = hand_in(memory)
    memory.delete([manifest.parts[0].key])

    with pytest.raises(ObjectMissing, match=manifest.parts[0].key):
        reader.read([manifest])


def test_what_was_learned_is_deleted_and_nothing_else(memory, reader):
    hand_in(memory, iteration=2)
    hand_in(memory, iteration=3)
    hand_in(memory, iteration=10)
    neighbour = RolloutWriter(ModelStore(memory, f"{PREFIX}/3"), Manifest(0, 0, CHECKPOINT, "s"))
    neighbour.add(played(5))
    neighbour.finish(Driving())

    reader.delete_learned(3)

    left = {info.key for info in memory.list("rollouts/")}
    assert {key.split("/")[3] for key in left} == {"3", "10"}
    assert all(
        key.startswith((f"rollouts/{PREFIX}/3/0/0/", f"rollouts/{PREFIX}/10/")) for key in left
    )


def test_a_manifest_that_claims_a_billion_rows_is_damage(memory):
    part = {
        "key": "k",
        "fingerprint": {"size_bytes": 2_000_000, "sha256": "a"},
        "episodes": 1,
        "steps": 10**9,
    }
    fields = {"iteration": 3, "worker": 0, "checkpoint": "3_Step-1.ckpt", "session": "s"}
    data = json.dumps({**fields, "parts": [part]}).encode()

    with pytest.raises(RecordError, match="2000000 bytes cannot hold"):
        Manifest.decode(data)


class Listed(MemoryBucket):
    """Counts its listings, and how often it is asked for an object that is not there."""

    looks = misses = 0

    def list(self, folder):
        self.looks += 1
        return super().list(folder)

    def get(self, key, *, watch=None):
        self.misses += not self.exists(key)
        return super().get(key, watch=watch)


@pytest.mark.parametrize("drive_s", [2.0, 20.0])
def test_a_bucket_elsewhere_is_listed_less_often_and_hardly_later(drive_s):
    looks, ends = [], []
    for frugal in (False, True):
        bucket, clock = Listed(), Clock()
        reader = RolloutReader(
            ModelStore(bucket, PREFIX), frugal=frugal, clock=clock, pause=clock.pause
        )
        for _ in range(4):
            bucket.looks = bucket.misses = 0
            bucket.delete([info.key for info in MemoryBucket.list(bucket, "")])
            began_s = clock.now_s
            clock.happens = {began_s + drive_s: lambda bucket=bucket: hand_in(bucket)}
            wait(reader, [0])
        looks.append(bucket.looks)
        ends.append(clock.now_s - began_s)
        reader.close()

    assert looks[1] <= 2 < looks[0]
    assert bucket.misses < looks[0]  # no more questions than there were listings
    assert ends[1] < 1.06 * drive_s + 0.1


@pytest.mark.parametrize("frugal", [False, True])
def test_a_reader_that_is_woken_looks_at_once(memory, clock, frugal):
    def pause(seconds):
        clock.pause(min(seconds, 5.0))
        hand_in(memory)
        return True

    reader = RolloutReader(
        ModelStore(memory, PREFIX), frugal=frugal, clock=clock, pause=pause, first_look_s=30
    )
    reader._waits_s.extend([60.0, 60.0])

    assert list(wait(reader, [0])) == [0]
    assert clock.now_s <= 5.0
    reader.close()


def test_a_frugal_reader_notices_within_a_second_that_it_should_stop(memory, clock):
    reader = RolloutReader(ModelStore(memory, PREFIX), frugal=True, clock=clock, pause=clock.pause)
    reader._waits_s.extend([60.0, 60.0])

    assert wait(reader, [0], should_stop=lambda: clock.now_s >= 3.0) == {}
    assert clock.now_s <= 4.1
    reader.close()


def test_what_was_driven_ahead_of_the_last_update_is_deleted_at_the_end():
    bucket = MemoryBucket()
    hand_in(bucket, iteration=2)
    hand_in(bucket, iteration=3)
    delete_unlearned(ModelStore(bucket, PREFIX))
    assert (
        find_manifest(ModelStore(bucket, PREFIX), 3, 0) is not None
    )  # no checkpoint says what is learned

    CheckpointStore(ModelStore(bucket, PREFIX)).save(3, 900, b"weights")
    delete_unlearned(ModelStore(bucket, PREFIX))

    assert (
        find_manifest(ModelStore(bucket, PREFIX), 2, 0) is not None
    )  # a replay buffer may need it
    assert find_manifest(ModelStore(bucket, PREFIX), 3, 0) is None


class MeetingBucket(MemoryBucket):
    """Answers a GET of some objects only while another one is asked for, too."""

    def __init__(self, end):
        super().__init__()
        self._end, self._meeting = end, threading.Barrier(2)

    def get(self, key):
        if key.endswith(self._end):
            self._meeting.wait(10.0)  # a reader that asks one after the other fails here
        return super().get(key)


def test_manifests_of_a_far_bucket_are_read_at_the_same_time(clock):
    bucket = MeetingBucket("manifest.json")
    for worker in range(4):
        hand_in(bucket, worker)
    reader = RolloutReader(ModelStore(bucket, PREFIX), frugal=True, clock=clock, pause=clock.pause)

    arrived = wait(reader, range(4))
    reader.close()

    assert list(arrived) == [0, 1, 2, 3]


def test_records_of_workers_are_read_at_the_same_time():
    bucket = MeetingBucket(".json")
    for number in range(4):
        record = MemberRecord(f"joined-{number}", "ours", "far", 1)
        bucket.put(keys.member(PREFIX, record.member), record.encode())

    members = MemberReader(ModelStore(bucket, PREFIX), "ours").read()

    assert sorted(members) == ["joined-0", "joined-1", "joined-2", "joined-3"]
