"""The trainer divides episodes between the workers that are there, whoever comes and goes."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from drcli.base.errors import StorageError
from drcli.bucket.bucket import Listing
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.model.training_state import FORGOTTEN_S, GONE_S, MISSED_S, RENEWED_S, read_shares
from drcli.records.job import MemberRecord, SharesRecord, WorkerShare
from drcli.train.episode_allocator import (
    FRUGAL_LOOK_S,
    KNOWN_AFTER,
    LATE_PAUSE_S,
    PUNCTUAL,
    TRIED_AGAIN_S,
    EpisodeAllocator,
)
from drcli.train.episode_share import AssignedShare, Share
from memory_bucket import MemoryBucket

PREFIX, SESSION = "model", "now"


class Machines:
    """Workers elsewhere, which renew their records as time passes."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.bucket = MemoryBucket(clock=lambda: self.now_s)
        self.records: dict[str, MemberRecord] = {}

    def clock(self) -> float:
        return self.now_s

    def join(self, name: str, *, ready: bool = True, session: str = SESSION) -> None:
        self.records[name] = MemberRecord(name, session, "far", 7, ready=ready)
        self._put(name)

    def has_seen(self, name: str, checkpoint: int) -> None:
        self.records[name] = replace(self.records[name], checkpoint=checkpoint, ready=True)

    def drives(self, name: str, iteration: int, steps: int, seconds: float) -> None:
        self.records[name] = replace(
            self.records[name], drives=iteration, steps=steps, drive_s=seconds
        )

    def leave(self, name: str) -> None:
        del self.records[name]
        self.bucket.delete([keys.member(PREFIX, name)])

    def silence(self, name: str) -> None:
        del self.records[name]

    def _put(self, name: str) -> None:
        self.bucket.put(keys.member(PREFIX, name), self.records[name].encode())

    def keeper(self, workers: int, episodes: int = 8, **options: object) -> EpisodeAllocator:
        keeper = EpisodeAllocator(
            ModelStore(self.bucket, PREFIX), SESSION, workers, clock=self.clock, **options
        )
        keeper.begin_stage(episodes, 0)
        return keeper

    def let_pass(self, seconds: float, keeper: EpisodeAllocator) -> None:
        """Time passes, in which workers renew and the trainer looks."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s += RENEWED_S
            for name, record in self.records.items():
                self.records[name] = replace(record, beat=record.beat + 1)
                self._put(name)
            keeper.look(wait=True)


@pytest.fixture
def machines() -> Machines:
    return Machines()


def who(keeper: EpisodeAllocator, checkpoint: int) -> list[tuple[int, str, int]]:
    return [(share.worker, share.member, share.count) for share in keeper.at(checkpoint)]


def test_nothing_is_written_as_long_as_nobody_has_joined(machines):
    keeper = machines.keeper(2)
    machines.let_pass(60.0, keeper)

    assert keeper.version_for(3) is None
    assert who(keeper, 3) == [(0, "", 4), (1, "", 4)]
    assert not machines.bucket.list("")


def test_a_worker_that_joins_shares_the_episodes_from_the_next_checkpoint_on(machines):
    keeper = machines.keeper(1)
    machines.join("far", ready=False)
    machines.let_pass(5.0, keeper)

    assert keeper.version_for(4) is None  # it has its number, but is not ready
    assert SharesRecord.decode(machines.bucket.get(keys.shares(PREFIX))).numbers == {"far": 1}

    machines.has_seen("far", 3)
    machines.let_pass(5.0, keeper)

    assert keeper.version_for(5) == 1
    assert who(keeper, 4) == [(0, "", 8)]
    assert who(keeper, 5) == [(0, "", 4), (1, "far", 4)]
    assert read_shares(ModelStore(machines.bucket, PREFIX), SESSION, 5).workers == keeper.at(5)
    assert keeper.version_for(6) == 1  # nothing has changed
    assert keeper.at(6) == keeper.at(5)


def test_no_two_episodes_of_a_worker_have_the_same_number(machines):
    keeper = machines.keeper(1)
    driven: dict[int, list[int]] = {0: [], 1: []}
    for checkpoint in range(12):
        if checkpoint == 4:
            machines.join("far")
        if checkpoint == 8:
            machines.leave("far")
        machines.let_pass(30.0, keeper)
        version = keeper.version_for(checkpoint)
        if version is None:
            driven[0] += Share(0, 1, 8).numbers(checkpoint)
            continue
        shares = read_shares(ModelStore(machines.bucket, PREFIX), SESSION, checkpoint)
        for share in shares.workers:
            driven[share.worker] += AssignedShare(shares, share).numbers(checkpoint)

    assert len(driven[0]) == len(set(driven[0])) == 4 * 8 + 4 * 4 + 4 * 8
    assert driven[0] == sorted(driven[0])
    assert driven[1] == list(range(16))


def test_equal_parts_are_those_of_workers_that_were_there_from_the_beginning(machines):
    keeper = machines.keeper(0, episodes=7)
    for name in ("a", "b", "c"):
        machines.join(name)
    machines.let_pass(5.0, keeper)
    keeper.version_for(0)

    shares = read_shares(ModelStore(machines.bucket, PREFIX), SESSION, 0)
    for share in shares.workers:
        fixed, assigned = Share(share.worker, 3, 7), AssignedShare(shares, share)
        for iteration in (0, 5):
            numbers = assigned.numbers(iteration)
            assert numbers == fixed.numbers(iteration)
            assert list(map(assigned.position, numbers)) == list(map(fixed.position, numbers))
    assert [AssignedShare(shares, share).evaluates for share in shares.workers] == [
        True,
        False,
        False,
    ]


def test_without_workers_of_its_own_the_training_waits_for_the_first(machines):
    keeper = machines.keeper(0)

    assert keeper.version_for(0) is None
    assert (keeper.at(0), keeper.nobody) == ((), True)
    assert not keeper.reassign(0)

    machines.join("far")
    machines.let_pass(5.0, keeper)

    assert keeper.reassign(0)
    assert who(keeper, 0) == [(0, "far", 8)]
    assert not keeper.nobody
    assert not keeper.reassign(0)


def test_when_all_have_left_the_next_one_drives_the_same_iteration(machines):
    keeper = machines.keeper(0)
    machines.join("first")
    machines.let_pass(5.0, keeper)
    keeper.reassign(3)
    machines.silence("first")
    machines.join("second")
    machines.let_pass(10.0, keeper)
    assert not keeper.reassign(3)  # the first may still be there

    machines.let_pass(GONE_S, keeper)

    assert keeper.reassign(3)
    assert who(keeper, 3) == [(1, "second", 8)]


def test_a_worker_that_is_late_pauses_and_its_share_is_driven_by_the_others(machines):
    keeper = machines.keeper(1)
    machines.join("far")
    machines.let_pass(5.0, keeper)
    keeper.version_for(1)
    assert len(who(keeper, 1)) == 2

    keeper.note({0: 100.0}, [1], 1)

    assert keeper.version_for(2) == 2
    assert who(keeper, 2) == [(0, "", 8)]
    machines.let_pass(2 * LATE_PAUSE_S, keeper)
    keeper.version_for(3)
    assert who(keeper, 3) == [(0, "", 8)]  # it has not come back yet
    machines.has_seen("far", 2)
    machines.let_pass(5.0, keeper)
    keeper.version_for(4)
    assert len(who(keeper, 4)) == 2


def test_the_pause_of_a_worker_doubles_until_it_is_in_time_again(machines):
    keeper = machines.keeper(1)
    machines.join("far")
    pauses = []
    for turn in range(3):
        machines.has_seen("far", 100 * turn)
        machines.let_pass(5.0, keeper)
        checkpoint = 100 * turn
        keeper.version_for(checkpoint)
        keeper.note({0: 100.0}, [1], checkpoint)
        machines.has_seen("far", checkpoint + 1)
        began_s = machines.now_s
        while len(who(keeper, checkpoint)) < 2 or checkpoint == 100 * turn:
            machines.let_pass(5.0, keeper)
            checkpoint += 1
            keeper.version_for(checkpoint)
        pauses.append(machines.now_s - began_s)
        if turn == 1:
            for _ in range(PUNCTUAL):
                keeper.note({0: 100.0, 1: 100.0}, [], checkpoint)

    assert pauses == [10.0, 20.0, 10.0]


def with_two(machines: Machines, episodes: int = 8) -> tuple[EpisodeAllocator, WorkerShare]:
    """A trainer with one worker of its own and one that has joined, and the share of the latter."""
    keeper = machines.keeper(1, episodes)
    machines.join("far")
    machines.let_pass(5.0, keeper)
    keeper.version_for(1)
    return keeper, keeper.at(1)[1]


def test_a_worker_that_was_too_slow_for_a_share_is_tried_again(machines):
    keeper, _ = with_two(machines)
    for _ in range(KNOWN_AFTER):
        keeper.note({0: 100.0, 1: 1.0}, [], 1)
    keeper.version_for(2)
    too_slow = who(keeper, 2)
    machines.let_pass(TRIED_AGAIN_S, keeper)
    keeper.version_for(3)
    tried = who(keeper, 3)
    keeper.note({0: 100.0, 1: 100.0}, [], 3)
    keeper.version_for(4)

    assert too_slow == [(0, "", 8)]
    assert tried == [(0, "", 7), (1, "far", 1)]
    assert who(keeper, 4) == [(0, "", 4), (1, "far", 4)]


def test_a_worker_that_idles_with_a_small_part_gets_a_larger_one(machines):
    keeper, _ = with_two(machines, episodes=44)
    for _ in range(KNOWN_AFTER):
        keeper.note({0: 100.0, 1: 10.0}, [], 1)
    parts = []
    for checkpoint in range(2, 5):
        keeper.version_for(checkpoint)
        parts.append(who(keeper, checkpoint)[1][2])
        # As fast as before for each step, but its few cars would be ready far too early.
        keeper.note({0: 10.0, 1: 14.0}, [], checkpoint)

    assert parts[0] == 4
    assert parts[0] < parts[1] < parts[2]


def test_nobody_waits_for_a_worker_that_is_silent(machines):
    keeper, share = with_two(machines)
    assert not keeper.is_hopeless(share, 1, 100.0, 10.0)

    machines.silence("far")
    machines.let_pass(MISSED_S - RENEWED_S, keeper)
    assert not keeper.is_hopeless(share, 1, 100.0, 10.0)
    machines.let_pass(RENEWED_S, keeper)

    assert keeper.is_hopeless(share, 1, 100.0, 10.0)


def test_nobody_waits_for_a_worker_that_has_left_or_starts_again(machines):
    keeper, share = with_two(machines)
    machines.join("far", ready=False)
    machines.let_pass(5.0, keeper)
    starts_again = keeper.is_hopeless(share, 1, 100.0, 10.0)
    machines.leave("far")
    machines.let_pass(5.0, keeper)

    assert starts_again
    assert keeper.is_hopeless(share, 1, 100.0, 10.0)


def test_a_trainer_that_has_not_looked_yet_gives_nobody_up(machines):
    _, share = with_two(machines)

    assert not machines.keeper(1).is_hopeless(share, 1, 100.0, 10.0)


@pytest.mark.parametrize(("driven", "hopeless"), [(49, True), (51, False)])
def test_nobody_waits_for_a_worker_that_is_too_slow_to_be_in_time(machines, driven, hopeless):
    keeper, share = with_two(machines)
    machines.drives("far", 1, driven, 10.0)
    machines.let_pass(5.0, keeper)

    # It has to drive 100 steps within 20 seconds.
    assert keeper.is_hopeless(share, 1, 100.0, 20.0) == hopeless


@pytest.mark.parametrize(("iteration", "seconds"), [(0, 10.0), (1, 1.0)])
def test_a_worker_is_not_judged_by_another_iteration_or_by_its_first_moments(
    machines, iteration, seconds
):
    keeper, share = with_two(machines)
    machines.drives("far", iteration, 0, seconds)
    machines.let_pass(5.0, keeper)

    assert not keeper.is_hopeless(share, 1, 100.0, 20.0)


def test_a_worker_that_becomes_slow_comes_back_with_a_small_share(machines):
    keeper, _ = with_two(machines, episodes=44)
    for _ in range(KNOWN_AFTER):
        keeper.note({0: 100.0, 1: 100.0}, [], 1)
    machines.drives("far", 1, 100, 10.0)
    machines.let_pass(5.0, keeper)
    keeper.note({0: 100.0}, [1], 1)
    machines.has_seen("far", 2)
    machines.let_pass(2 * LATE_PAUSE_S, keeper)
    keeper.version_for(3)

    assert who(keeper, 3) == [(0, "", 40), (1, "far", 4)]


def test_slow_workers_drive_less_unless_shares_must_be_equal(machines):
    parts = {}
    for equal in (False, True):
        keeper = machines.keeper(1, equal=equal)
        machines.join("slow")
        machines.let_pass(5.0, keeper)
        keeper.version_for(1)
        keeper.note({0: 300.0, 1: 1.0}, [], 1)  # it compiled
        for _ in range(KNOWN_AFTER - 1):
            keeper.note({0: 300.0, 1: 100.0}, [], 1)
        keeper.version_for(2)
        parts[equal] = [count for _, _, count in who(keeper, 2)]
        keeper.close()

    assert parts == {False: [6, 2], True: [4, 4]}


def test_the_worker_that_evaluates_always_has_an_episode(machines):
    keeper = machines.keeper(1)
    machines.join("fast")
    machines.let_pass(5.0, keeper)
    keeper.version_for(1)
    for _ in range(KNOWN_AFTER):
        keeper.note({0: 1.0, 1: 900.0}, [], 1)
    keeper.version_for(2)

    assert who(keeper, 2) == [(0, "", 1), (1, "fast", 7)]


def test_a_number_is_free_again_when_its_worker_has_left_or_was_silent_for_long(machines):
    keeper = machines.keeper(1)
    for name in ("a", "b"):
        machines.join(name)
    machines.let_pass(5.0, keeper)
    machines.leave("a")
    machines.silence("b")
    machines.let_pass(FORGOTTEN_S + 10.0, keeper)
    machines.join("c")
    machines.let_pass(10.0, keeper)
    keeper.version_for(9)

    assert who(keeper, 9)[1:] == [(1, "c", 4)]
    assert not machines.bucket.exists(keys.member(PREFIX, "b"))


def test_workers_of_an_earlier_start_do_not_count(machines):
    keeper = machines.keeper(0)
    machines.join("far", session="before")
    machines.let_pass(10.0, keeper)

    assert keeper.nobody
    assert not keeper.reassign(0)


def test_a_trainer_that_was_started_again_goes_on_with_the_same_shares(machines):
    first = machines.keeper(0)
    for name in ("a", "b"):
        machines.join(name)
    machines.let_pass(5.0, first)
    first.version_for(4)
    before = first.at(4)
    first.close()

    second = machines.keeper(0)

    assert second.at(4) == before
    machines.let_pass(5.0, second)
    assert second.version_for(5) == 1
    assert second.at(5) == before


def test_after_a_rollback_older_shares_count_again(machines):
    keeper = machines.keeper(1)
    machines.join("a")
    machines.let_pass(5.0, keeper)
    keeper.version_for(5)
    machines.join("b")
    machines.let_pass(5.0, keeper)
    keeper.version_for(9)
    assert len(who(keeper, 9)) == 3

    again = machines.keeper(1)

    assert len(who(again, 6)) == 2
    machines.let_pass(5.0, again)
    assert again.version_for(7) == 3
    assert len(who(again, 7)) == 3


def test_the_failure_of_a_worker_is_told_where_the_training_runs(machines, logged):
    keeper = machines.keeper(0)
    machines.join("far")
    machines.records["far"] = replace(machines.records["far"], failure="the reward is None")
    machines.let_pass(5.0, keeper)
    machines.silence("far")

    assert keeper.failure == "far: the reward is None"
    assert "far has failed on far: the reward is None" in logged()
    assert keeper.nobody
    assert not machines.bucket.exists(keys.member(PREFIX, "far"))


def test_looks_that_cost_money_are_rare(machines):
    looks = 0

    class Counting(MemoryBucket):
        def list(self, folder: str) -> Listing:
            nonlocal looks
            looks += 1
            return super().list(folder)

    machines.bucket = Counting(clock=machines.clock)
    keeper = machines.keeper(1, frugal=True)
    for _ in range(600):
        machines.now_s += 0.1
        keeper.look(wait=True)

    assert looks == 60.0 / FRUGAL_LOOK_S


def test_a_bucket_that_does_not_answer_is_said_and_the_shares_stay(machines, logged):
    keeper = machines.keeper(1)
    machines.join("a")
    machines.let_pass(5.0, keeper)
    keeper.version_for(1)
    failing: Callable[[str], list[object]] = _refuse(StorageError("no answer", remedy="wait"))
    machines.bucket.list = failing
    machines.now_s += 10.0
    keeper.look(wait=True)

    assert "Cannot see which workers have joined: no answer" in logged()
    assert len(who(keeper, 1)) == 2


def _refuse(error: Exception) -> Callable[[str], list[object]]:
    def refuse(_folder: str) -> list[object]:
        raise error

    return refuse


def test_shares_change_with_the_first_iteration_that_nobody_can_have_begun(machines):
    keeper = machines.keeper(1, lag=3)
    machines.join("a")
    machines.let_pass(5.0, keeper)
    keeper.version_for(5)
    machines.join("b")
    machines.let_pass(5.0, keeper)
    keeper.version_for(6)

    assert [len(who(keeper, iteration)) for iteration in (7, 8, 9)] == [1, 2, 3]
    # Workers that are ahead and workers that are behind find the same.
    for iteration in (8, 9):
        shares = read_shares(ModelStore(machines.bucket, PREFIX), SESSION, iteration)
        assert shares.workers == keeper.at(iteration)


def test_what_changes_each_time_is_known_for_all_iterations_that_are_driven(machines):
    keeper = machines.keeper(1, lag=6)
    driven: list[int] = list(Share(0, 1, 8).numbers(0))
    for checkpoint in range(1, 16):
        name = f"worker-{checkpoint}"
        machines.join(name)
        machines.let_pass(5.0, keeper)
        keeper.version_for(checkpoint)
        shares = read_shares(ModelStore(machines.bucket, PREFIX), SESSION, checkpoint)
        if shares is None:
            driven += Share(0, 1, 8).numbers(checkpoint)
        else:
            driven += AssignedShare(shares, shares.of(0)).numbers(checkpoint)

    assert len(driven) == len(set(driven))
    assert len(who(keeper, 15)) == min(8, 15 - 6 + 1)


def test_a_stage_begins_with_its_own_shares_though_workers_were_ahead(machines):
    keeper = machines.keeper(1, lag=3)
    machines.join("a")
    machines.let_pass(5.0, keeper)
    for checkpoint in (4, 5):
        keeper.version_for(checkpoint)
    assert [count for _, _, count in who(keeper, 8)] == [4, 4]

    keeper.begin_stage(20, 20, first=6)
    keeper.version_for(6)

    assert [count for _, _, count in who(keeper, 6)] == [10, 10]
    first = {share.worker: share.first for share in keeper.at(6)}
    keeper.version_for(7)
    assert {share.worker: share.first for share in keeper.at(7)} == first  # nothing has changed


def test_when_all_have_left_the_next_one_drives_the_open_iteration_and_those_ahead(machines):
    keeper = machines.keeper(0, lag=3)
    machines.join("first")
    machines.let_pass(5.0, keeper)
    keeper.reassign(0)
    keeper.version_for(1)
    machines.silence("first")
    machines.join("second")
    machines.let_pass(GONE_S + 5.0, keeper)

    assert keeper.reassign(1)
    assert [who(keeper, iteration) for iteration in (1, 4)] == [[(1, "second", 8)]] * 2
