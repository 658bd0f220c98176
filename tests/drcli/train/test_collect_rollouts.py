"""The trainer waits for its workers, but for none of them too long."""

import numpy as np
import pytest

from drcli.learn.rollout_buffer import Rollout
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.job import WorkerShare
from drcli.records.rollout import Driving, Episodes, Manifest
from drcli.train.rollouts import (
    JOINED_PATIENCE_S,
    LEAST_PATIENCE_S,
    STARTING_PATIENCE_S,
    Collector,
    RolloutReader,
    RolloutWriter,
    find_manifest,
)
from memory_bucket import MemoryBucket

PREFIX = "model"

POLL_S = 1.0
"""Longest pause between two looks for rollouts."""


ONE = (WorkerShare(0, "", 0, 2),)
TWO = (*ONE, WorkerShare(1, "", 0, 2))
JOINED = (*ONE, WorkerShare(1, "joined-far", 0, 2))


class Clock:
    """Time that passes only while somebody waits."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s

    def pause(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def bucket() -> MemoryBucket:
    return MemoryBucket()


@pytest.fixture
def reader(bucket, clock):
    reader = RolloutReader(ModelStore(bucket, PREFIX), clock=clock, pause=clock.pause)
    yield reader
    reader.close()


def hand_in(bucket, worker: int, iteration: int = 0, lengths=(3, 2), drive_s=4.0) -> None:
    manifest = Manifest(iteration, worker, f"{iteration}_Step-9.ckpt", "s")
    writer = RolloutWriter(ModelStore(bucket, PREFIX), manifest)
    steps, episodes = sum(lengths), len(lengths)
    writer.add(
        Episodes(
            Rollout(
                frames=np.zeros((steps, 1, 12, 16), np.uint8),
                actions=np.zeros(steps, np.int64),
                log_probs=np.zeros(steps, np.float32),
                values=np.zeros(steps),
                rewards=np.ones(steps),
                lengths=np.array(lengths),
                last_values=np.zeros(episodes),
                cut=np.zeros(episodes, np.bool_),
                scans=np.zeros((steps, 0), np.float32),
                states=np.zeros((steps, 0), np.float32),
            ),
            numbers=np.arange(episodes)[::-1].copy() + 10 * worker,
            progress=np.linspace(10.0, 20.0, episodes),
            completed=np.arange(episodes) == 0,
            duration_s=np.full(episodes, 2.0),
        )
    )
    writer.finish(Driving(drive_s, 0 if worker == 0 else None))


def test_the_episodes_of_all_workers_come_together(bucket, reader):
    hand_in(bucket, 0, drive_s=4.0)
    hand_in(bucket, 1, drive_s=6.0)

    got = Collector(reader, 1_000).collect(0, ["0_Step-9.ckpt"], TWO, lambda: False)

    assert got.rollout.lengths.tolist() == [3, 2, 3, 2]
    assert (got.record.mean_reward, got.record.full_laps, got.record.best_lap_s) == (2.5, 2, 2.0)
    assert (got.record.drive_s, got.simulated_s, got.evaluates) == (6.0, 8.0, 0)


def test_a_dead_worker_is_waited_for_once_and_then_no_more(bucket, reader, clock):
    collector = Collector(reader, 1_000)
    for iteration in (0, 1):
        hand_in(bucket, 0, iteration)

    assert collector.collect(0, ["0_Step-9.ckpt"], TWO, lambda: False) is not None
    first_s = clock.now_s
    assert collector.collect(1, ["1_Step-9.ckpt"], TWO, lambda: False) is not None

    # A slow start shall not leave the first trace of a worker out.
    assert first_s == pytest.approx(STARTING_PATIENCE_S, abs=POLL_S)
    assert clock.now_s == first_s


@pytest.mark.parametrize("data", [None, b"damaged"])
def test_an_iteration_with_lost_parts_is_handed_back_to_its_workers(bucket, reader, data):
    hand_in(bucket, 0)
    [part] = [o.key for o in bucket.list(keys.rollouts_folder(PREFIX)) if "manifest" not in o.key]
    bucket.delete([part])
    if data is not None:
        bucket.put(part, data)
    collector = Collector(reader, 1_000)

    assert collector.collect(0, ["0_Step-9.ckpt"], ONE, lambda: False) is None
    assert find_manifest(ModelStore(bucket, PREFIX), 0, 0) is None

    hand_in(bucket, 0)
    assert collector.collect(0, ["0_Step-9.ckpt"], ONE, lambda: False) is not None


def test_a_worker_that_comes_back_counts_again(bucket, reader, clock):
    collector = Collector(reader, 1_000)
    hand_in(bucket, 0, 0)
    collector.collect(0, ["0_Step-9.ckpt"], TWO, lambda: False)
    hand_in(bucket, 0, 1)
    hand_in(bucket, 1, 1)
    hand_in(bucket, 0, 2)

    got = collector.collect(1, ["1_Step-9.ckpt"], TWO, lambda: False)
    before_s = clock.now_s
    collector.collect(2, ["2_Step-9.ckpt"], TWO, lambda: False)

    assert got.record.episodes == 4
    assert clock.now_s - before_s == pytest.approx(LEAST_PATIENCE_S, abs=POLL_S)


def test_a_slow_worker_gets_as_long_again_as_the_first_one_took(bucket, reader, clock):
    hand_in(bucket, 0, drive_s=190.0)

    Collector(reader, 1_000).collect(0, ["0_Step-9.ckpt"], TWO, lambda: False)

    assert clock.now_s == pytest.approx(190.0, abs=POLL_S)


def test_a_stop_ends_the_wait_without_rollouts(reader):
    assert Collector(reader, 1_000).collect(0, ["0_Step-9.ckpt"], TWO, lambda: True) is None


def test_what_is_too_much_is_left_out_from_the_last_episode_on(bucket, reader, logged):
    hand_in(bucket, 0, lengths=(4, 3, 2))

    got = Collector(reader, 5).collect(0, ["0_Step-9.ckpt"], ONE, lambda: False)

    assert got.rollout.lengths.tolist() == [3, 2]  # numbers 1 and 0, in the order driven
    assert "Learning from 2 of 3 episodes" in logged()


def test_older_rollouts_can_be_recalled(bucket, reader):
    hand_in(bucket, 0, iteration=4)
    hand_in(bucket, 1, iteration=4)
    collector = Collector(reader, 1_000)

    assert reader.iterations() == [4]
    assert collector.recall(4).steps == 10
    assert collector.recall(3) is None


@pytest.mark.parametrize("data", [None, b"cut"], ids=["lost", "damaged"])
def test_an_older_iteration_with_a_bad_part_is_not_remembered_and_said(
    bucket, reader, data, logged
):
    hand_in(bucket, 0, iteration=4)
    part = find_manifest(ModelStore(bucket, PREFIX), 4, 0).parts[0].key
    bucket.delete([part])
    if data is not None:
        bucket.put(part, data)

    assert Collector(reader, 1_000).recall(4) is None
    assert "Cannot learn from iteration 4 again" in logged()


def test_the_learner_waits_less_for_a_worker_that_has_joined(bucket, reader, clock):
    hand_in(bucket, 0, drive_s=0.5)

    got = Collector(reader, 1_000).collect(0, ["0_Step-9.ckpt"], JOINED, lambda: False)

    assert clock.now_s == pytest.approx(JOINED_PATIENCE_S, abs=POLL_S)
    assert got.late == (1,)
    assert got.speeds == {0: 5 / 0.5}


def test_a_worker_with_a_part_of_the_usual_share_gets_that_part_of_the_patience(
    bucket, reader, clock
):
    hand_in(bucket, 0, lengths=(2,) * 8, drive_s=100.0)
    shares = (WorkerShare(0, "", 0, 8), WorkerShare(1, "joined-far", 0, 2))

    Collector(reader, 1_000).collect(0, ["0_Step-9.ckpt"], shares, lambda: False)

    assert 25.0 <= clock.now_s < 26.5


def test_a_small_part_is_not_waited_for_when_the_last_large_one_has_come(bucket, clock):
    hand_in(bucket, 0, lengths=(2,) * 8, drive_s=100.0)
    shares = (
        WorkerShare(0, "", 0, 8),
        WorkerShare(1, "joined-slow", 0, 2),
        WorkerShare(2, "joined-late", 0, 8),
    )

    def pause(seconds: float) -> None:
        clock.pause(seconds)
        if 60.0 <= clock.now_s < 60.0 + seconds:
            hand_in(bucket, 2, lengths=(2,) * 8, drive_s=160.0)

    reader = RolloutReader(ModelStore(bucket, PREFIX), clock=clock, pause=pause)
    got = Collector(reader, 1_000).collect(0, ["0_Step-9.ckpt"], shares, lambda: False)
    reader.close()

    assert 60.0 <= clock.now_s < 62.5
    assert (got.record.episodes, got.late) == (16, (1,))


def test_a_small_part_that_comes_first_does_not_shorten_the_patience_for_larger_ones(
    bucket, reader, clock
):
    hand_in(bucket, 1, lengths=(5, 5), drive_s=10.0)
    shares = (WorkerShare(1, "joined-slow", 0, 2), WorkerShare(2, "joined-far", 0, 6))

    Collector(reader, 1_000).collect(0, ["0_Step-9.ckpt"], shares, lambda: False)

    # It would have taken 30 s for the larger part, so that one has 60 s in all.
    assert clock.now_s == pytest.approx(50.0, abs=2.5)


def test_nobody_waits_for_a_joined_worker_that_is_given_up(bucket, reader, clock):
    hand_in(bucket, 0, lengths=(5, 7), drive_s=60.0)
    asked = []

    def is_hopeless(share, iteration, steps, within_s):
        asked.append((share.worker, iteration, steps, within_s))
        return clock.now_s >= 3.0

    got = Collector(reader, 1_000).collect(0, ["0_Step-9.ckpt"], JOINED, lambda: False, is_hopeless)

    assert 3.0 <= clock.now_s < 4.0
    assert got.late == (1,)
    assert set(asked) == {(1, 0, 12.0, 120.0)}


def test_a_worker_of_the_training_is_never_given_up(bucket, reader, clock):
    hand_in(bucket, 0, drive_s=60.0)

    def fail(*_words):
        raise AssertionError

    Collector(reader, 1_000).collect(0, ["0_Step-9.ckpt"], TWO, lambda: False, fail)

    assert clock.now_s == pytest.approx(STARTING_PATIENCE_S, abs=POLL_S)


def test_a_joined_worker_that_came_late_is_waited_for_when_it_has_a_share_again(bucket, reader):
    collector = Collector(reader, 1_000)
    hand_in(bucket, 0, 0)
    hand_in(bucket, 0, 1)
    hand_in(bucket, 1, 1)

    late = collector.collect(0, ["0_Step-9.ckpt"], JOINED, lambda: False).late
    again = collector.collect(1, ["1_Step-9.ckpt"], JOINED, lambda: False)

    assert late == (1,)
    assert (again.record.episodes, again.late) == (4, ())


def test_only_those_who_have_a_share_are_waited_for(bucket, reader, clock):
    hand_in(bucket, 0)

    got = Collector(reader, 1_000).collect(0, ["0_Step-9.ckpt"], ONE, lambda: False)

    assert (clock.now_s, got.late) == (0.0, ())


def test_who_may_have_begun_before_the_wait_gets_twice_the_time(bucket, reader, clock):
    collector = Collector(reader, 1_000, ahead=True)
    for iteration in (0, 1):
        hand_in(bucket, 0, iteration, drive_s=100.0)
        hand_in(bucket, 1, iteration)
    collector.collect(0, ["0_Step-9.ckpt"], JOINED, lambda: False)
    bucket.delete([keys.rollout_manifest(PREFIX, 1, 1)])
    before_s = clock.now_s

    collector.collect(1, ["1_Step-9.ckpt"], JOINED, lambda: False)

    assert clock.now_s - before_s == pytest.approx(200.0, abs=POLL_S)


def test_a_worker_that_was_late_once_does_not_take_the_place_of_another(bucket, reader):
    collector = Collector(reader, 1_000)
    hand_in(bucket, 0, 0)
    collector.collect(0, ["0_Step-9.ckpt"], TWO, lambda: False)
    hand_in(bucket, 1, 1)
    looks = iter([False] * 3)

    def arrives_later() -> bool:
        if next(looks, None) is None and find_manifest(ModelStore(bucket, PREFIX), 1, 0) is None:
            hand_in(bucket, 0, 1)
        return False

    got = collector.collect(1, ["1_Step-9.ckpt"], TWO, arrives_later)

    assert got.rollout.lengths.tolist() == [3, 2, 3, 2]
