"""What becomes of a training that was held up while another one took its model over."""

import random
from collections.abc import Callable, Iterator

import pytest

from drcli.base.errors import OwnershipLost, SettingsError, StorageError
from drcli.model import keys, lease
from drcli.model.checkpoints import CheckpointStore
from drcli.model.history import History
from drcli.model.lease import Ownership, read_lease, write_lease
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters
from drcli.records.rollout import Driving, Manifest, session_of_worker
from drcli.run.interruption_watch import LEASE_POLL_S, RENEW_S, Renewal
from drcli.train.rollouts import RolloutReader, RolloutWriter
from iterations import iteration_record
from memory_bucket import MemoryBucket

PREFIX = "model"


class Server:
    """A bucket and its clock, which nothing but the test moves."""

    def __init__(self) -> None:
        self.now_s = 1_000_000.0
        self.bucket = MemoryBucket(clock=self.clock)

    def clock(self) -> float:
        return self.now_s

    def renewal(self, session: str) -> Renewal:
        taken = lease.take(ModelStore(self.bucket, PREFIX), session)
        return Renewal(ModelStore(self.bucket, PREFIX), taken, clock=self.clock)

    def ownership(self, session: str) -> Ownership:
        return Ownership(ModelStore(self.bucket, PREFIX), session, clock=self.clock)


@pytest.fixture
def server() -> Server:
    return Server()


def test_a_renewed_lease_stays_fresh_and_is_not_written_more_often_than_needed(server):
    renewal = server.renewal("ours")
    ages = []
    for _ in range(20):
        server.now_s += LEASE_POLL_S
        renewal.step()
        ages.append(lease.holder(ModelStore(server.bucket, PREFIX)).age_s)

    assert renewal.lost is None
    assert max(ages) <= RENEW_S
    assert ages.count(0.0) <= 20 * LEASE_POLL_S / RENEW_S + 1


def test_the_owner_never_writes_over_the_lease_of_another(server):
    renewal = server.renewal("ours")
    server.now_s += 70.0
    theirs = lease.take(ModelStore(server.bucket, PREFIX), "theirs")

    renewal.step()

    assert renewal.lost is not None
    assert renewal.lost.code == 8
    assert f"process {theirs.pid} on {theirs.host}" in str(renewal.lost)
    assert lease.holder(ModelStore(server.bucket, PREFIX)).session == "theirs"


def test_an_owner_that_slept_while_another_trained_and_ended_goes_no_further(server):
    renewal = server.renewal("ours")
    server.now_s += 70.0
    lease.take(ModelStore(server.bucket, PREFIX), "theirs")
    lease.release(ModelStore(server.bucket, PREFIX), "theirs")

    renewal.step()

    assert "was trained by process" in str(renewal.lost)


def test_a_lease_that_is_lost_by_accident_is_written_again(server):
    renewal = server.renewal("ours")
    server.now_s += LEASE_POLL_S
    server.bucket.delete([keys.lease(PREFIX)])

    renewal.step()

    assert renewal.lost is None
    assert lease.holder(ModelStore(server.bucket, PREFIX)).session == "ours"


def test_a_lease_that_went_while_the_owner_was_held_up_is_not(server):
    renewal = server.renewal("ours")
    server.now_s += 70.0
    server.bucket.delete([keys.lease(PREFIX)])

    renewal.step()

    assert "could not be reached for 70 s" in str(renewal.lost)


def test_the_late_writing_of_an_owner_from_before_is_put_right(server):
    before = lease.take(ModelStore(server.bucket, PREFIX), "theirs")
    server.now_s += 70.0
    renewal, ownership = server.renewal("ours"), server.ownership("ours")
    ownership.check("key")
    write_lease(ModelStore(server.bucket, PREFIX), before)
    server.now_s += LEASE_POLL_S

    ownership.check("key")
    renewal.step()

    assert renewal.lost is None
    assert read_lease(ModelStore(server.bucket, PREFIX)).session == "ours"


def test_an_owner_that_is_held_up_between_reading_and_writing_does_not_write(server):
    class Slow(MemoryBucket):
        def get_with_age(self, key):
            found = super().get_with_age(key)
            server.now_s += 70.0
            lease.take(ModelStore(server.bucket, PREFIX), "theirs")
            return found

    renewal = server.renewal("ours")
    server.now_s += RENEW_S
    slow = Slow(clock=server.clock)
    slow._objects = server.bucket._objects
    renewal._model = ModelStore(slow, PREFIX)

    renewal.step()

    assert lease.holder(ModelStore(server.bucket, PREFIX)).session == "theirs"


def test_nothing_is_written_below_a_model_that_another_has_taken(server):
    lease.take(ModelStore(server.bucket, PREFIX), "ours")
    fenced = server.bucket.fenced(server.ownership("ours").check)
    fenced.put("model/before", b"")
    server.now_s += 70.0
    lease.take(ModelStore(server.bucket, PREFIX), "theirs")

    with pytest.raises(OwnershipLost):
        fenced.put("model/after", b"")
    with pytest.raises(OwnershipLost):
        fenced.delete(["model/before"])

    assert [info.key for info in server.bucket.list("model/")] == ["model/before"]


def test_writes_in_a_row_read_the_lease_once(server):
    reads = []

    class Counting(MemoryBucket):
        def get_with_age(self, key):
            reads.append(key)
            return super().get_with_age(key)

    bucket = Counting(clock=server.clock)
    lease.take(ModelStore(bucket, PREFIX), "ours")
    reads.clear()
    fenced = bucket.fenced(Ownership(ModelStore(bucket, PREFIX), "ours", clock=server.clock).check)
    for number in range(10):
        fenced.put(f"{number}", b"")

    assert len(reads) == 1


def test_a_pointer_is_not_written_on_what_was_read_a_while_ago(server):
    lease.take(ModelStore(server.bucket, PREFIX), "ours")
    fenced = server.bucket.fenced(server.ownership("ours").check)
    fenced.put(keys.checkpoint_tensors(PREFIX, "1_Step-9.ckpt"), b"weights")
    server.now_s += 0.2
    lease.take(ModelStore(server.bucket, PREFIX), "theirs")

    with pytest.raises(OwnershipLost):
        fenced.put(keys.coach_checkpoint(PREFIX), b"1_Step-9.ckpt")


def test_a_lease_that_cannot_be_read_stops_the_writing(server):
    class Broken(MemoryBucket):
        def get_with_age(self, key):
            raise StorageError("Nothing answers.", remedy="Start it.")

    bucket = Broken()
    fenced = bucket.fenced(Ownership(ModelStore(bucket, PREFIX), "ours").check)

    with pytest.raises(StorageError):
        fenced.put("key", b"")

    assert bucket.list("") == []


# Takeovers at random.


class Training:
    """One start: its supervisor, and what its workers write, in the order in which they do."""

    def __init__(self, world: "World", number: int) -> None:
        self.world = world
        self.number = number
        session = f"start{number}"
        self.session = session
        self.renewal = world.server.renewal(session)
        held_up = Holding(world, self)
        held_up._objects = world.server.bucket._objects
        self.bucket = held_up.fenced(world.server.ownership(session).check)
        self.stopped_until_s = 0.0
        self.next_look_s = world.now_s
        self.ended_s: float | None = None
        self.iterations = 0
        self.acts = self.train()

    @property
    def is_free(self) -> bool:
        return self.ended_s is None and self is not self.world.stopped

    def step(self) -> None:
        try:
            if self.world.rng.random() < 0.7:
                next(self.acts)
            elif self.world.now_s >= self.next_look_s:
                self.next_look_s = self.world.now_s + LEASE_POLL_S
                self.renewal.step()
        except OwnershipLost:
            self.ended_s = self.world.now_s
        if self.renewal.lost is not None and self.ended_s is None:
            self.ended_s = self.world.now_s

    def train(self) -> Iterator[None]:
        store = CheckpointStore(ModelStore(self.bucket, PREFIX))
        history = History(ModelStore(self.bucket, PREFIX))
        reader = RolloutReader(ModelStore(self.bucket, PREFIX), self.session, pause=lambda _: None)
        found = store.load_latest()
        number = 0 if found is None else found.record.number
        if found is None:
            store.save(0, 0, b"weights")
        else:
            history.restore(number, found.record.counters.learned)
            store.point_to(found.record)
        drive = 0
        while True:
            drive += 1
            name = str(store.pointed())
            session = session_of_worker(self.session, 1, drive)
            writer = RolloutWriter(
                ModelStore(self.bucket, PREFIX), Manifest(number, 0, name, session)
            )
            writer.finish(Driving())
            yield
            self.bucket.put(keys.training_trace(PREFIX, number), f"{self.number}".encode())
            yield
            arrived = reader.wait_manifests(number, [name], [0], enough=1)
            assert arrived, "somebody wrote over the rollouts of the owner"
            yield
            record = iteration_record(number, episodes=self.number)
            number += 1
            weights = f"weights of {self.number}".encode()
            store.save(number, 0, weights, counters=Counters(learned=record))
            yield
            history.add(record)
            reader.delete_learned(number - 2)
            self.iterations += 1
            yield


class Holding(MemoryBucket):
    """The way of one training to the bucket, on which it may be stopped for any time."""

    def __init__(self, world: "World", training: Training) -> None:
        super().__init__(clock=world.server.clock)
        self._world = world
        self._training = training

    def put(self, key, data, *, watch=None):
        self._world.perhaps_stop(self._training)
        super().put(key, data, watch=watch)


class World:
    """Machines that train one model, one after the other as they should."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.server = Server()
        self.trainings: list[Training] = []
        self.stopped: Training | None = None
        self.calm = False

    @property
    def now_s(self) -> float:
        return self.server.now_s

    def try_to_start(self) -> None:
        try:
            lease.refuse_other_owner(ModelStore(self.server.bucket, PREFIX))
        except SettingsError:
            return
        self.trainings.append(Training(self, len(self.trainings)))

    def perhaps_stop(self, training: Training) -> None:
        """Stop a training in the middle of what it does, while the others go on."""
        if self.calm or self.stopped is not None or self.rng.random() > 0.05:
            return
        self.stopped = training
        training.stopped_until_s = self.now_s + self.rng.uniform(5.0, 180.0)
        self.go_on(lambda: self.now_s >= training.stopped_until_s)
        self.stopped = None

    def go_on(self, until: Callable[[], bool]) -> None:
        while not until():
            self.server.now_s += 1.0
            for training in self.rng.sample(self.trainings, len(self.trainings)):
                if training.is_free:
                    training.step()
            if self.rng.random() < 0.2:
                self.try_to_start()


@pytest.mark.parametrize("seed", range(20))
def test_of_two_trainings_the_loser_ends_soon_and_no_iteration_has_two_owners(seed):
    world = World(seed)
    world.try_to_start()

    world.go_on(lambda: len(world.trainings) >= 3 and world.trainings[-1].iterations >= 5)
    last_s = world.now_s + 15.0 + max(t.stopped_until_s - world.now_s for t in world.trainings)
    world.calm = True
    world.go_on(lambda: world.now_s >= last_s)

    *losers, winner = world.trainings
    assert winner.ended_s is None
    for loser in losers:
        assert loser.ended_s is not None
        assert loser.ended_s - loser.stopped_until_s <= 15.0
    records = History(ModelStore(world.server.bucket, PREFIX)).records
    assert [r.iteration for r in records] == list(range(len(records)))
    for record in records:
        trace = world.server.bucket.get(keys.training_trace(PREFIX, record.iteration))
        assert int(trace) == record.episodes
    assert len(records) >= winner.iterations


def test_only_the_newest_trainer_of_a_start_may_write(server):
    renewal = server.renewal("ours")
    first, second = (
        Ownership(ModelStore(server.bucket, PREFIX), "ours", trainer=number, clock=server.clock)
        for number in (0, 1)
    )
    worker = server.ownership("ours")
    first.check(keys.history(PREFIX))

    renewal.begin_trainer(1)
    server.now_s += 1.0

    with pytest.raises(OwnershipLost, match="Another process is the trainer now"):
        first.check(keys.history(PREFIX))
    second.check(keys.history(PREFIX))
    worker.check(keys.history(PREFIX))


def test_the_number_of_the_trainer_stays_in_the_lease_when_it_is_renewed(server):
    renewal = server.renewal("ours")
    renewal.begin_trainer(2)

    server.now_s += RENEW_S
    renewal.step()

    assert read_lease(ModelStore(server.bucket, PREFIX)).trainer == 2
