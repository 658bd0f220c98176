import pytest

from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters
from drcli.records.rollout import Manifest
from drcli.records.run_record import TrainingEnd
from drcli.train.wait_for_trainer import QUIET_SHARE, RECHECK_S, CheckpointWaiter
from drcli.workers.worker_process import StopRequested
from iterations import iteration_record
from memory_bucket import MemoryBucket

PREFIX, SESSION = "model", "this start"


class World:
    """A bucket, a clock that only waiting moves, and what happens at some times."""

    def __init__(self, *, frugal: bool = False) -> None:
        self.now_s = 0.0
        self.looks_s: list[float] = []
        self.events: list[tuple[float, object]] = []
        self.stops = False
        self.wakes_s: float | None = None
        self.bucket = MemoryBucket()
        self.store = CheckpointStore(ModelStore(self.bucket, PREFIX))
        self.waiter = CheckpointWaiter(
            ModelStore(self.bucket, PREFIX),
            SESSION,
            0,
            frugal=frugal,
            should_stop=lambda: self.stops,
            say=lambda text: self.looks_s.append(self.now_s),
            clock=lambda: self.now_s,
            pause=self.pause,
        )

    def at(self, time_s: float, event) -> None:
        self.events.append((time_s, event))

    def pause(self, seconds: float) -> bool:
        until_s = self.now_s + seconds
        woken = self.wakes_s is not None and self.wakes_s <= until_s
        if woken:
            until_s, self.wakes_s = max(self.now_s, self.wakes_s), None
        self.now_s = until_s
        assert self.now_s < 1000.0, "waits for ever"
        for due in [e for e in self.events if e[0] <= self.now_s]:
            self.events.remove(due)
            due[1]()
        return woken

    def publish(self, number: int) -> None:
        """A new checkpoint, and what was driven with it by the time that anybody waits."""
        self.store.save(number, 100 * number, b"weights")
        self.hand_in(number, f"{number}_Step-{100 * number}.ckpt")

    def hand_in(self, iteration: int, checkpoint: str) -> None:
        manifest = Manifest(iteration, 0, checkpoint, SESSION, ())
        self.bucket.put(keys.rollout_manifest(PREFIX, iteration, 0), manifest.encode())

    def lose(self, iteration: int) -> None:
        self.bucket.delete([keys.rollout_manifest(PREFIX, iteration, 0)])

    def end(self, session: str = SESSION) -> None:
        self.bucket.put(keys.finished(PREFIX), TrainingEnd(session, "").encode())


@pytest.fixture
def world() -> World:
    return World()


def test_the_checkpoint_that_is_there_is_taken_at_once(world):
    world.publish(3)

    name = world.waiter.wait(3, newest=2, steps=500, since_s=0.0)

    assert name.number == 3
    assert world.now_s == 0.0


def learned(seconds: float, steps: int) -> Counters:
    """What a checkpoint says of the iteration that made it."""
    return Counters(learned=iteration_record(learn_s=seconds, steps=steps))


def learn_from(world, *learn_s: float, steps: int = 500) -> None:
    """Checkpoints that the trainer learned so long from so many steps to make."""
    for number, seconds in enumerate(learn_s):
        counters = learned(seconds, steps)
        record = world.store.save(number, steps * number, b"", counters=counters)
        world.waiter.learn_from(record)


def test_nobody_looks_while_the_learner_cannot_be_ready_yet(world):
    learn_from(world, 10.0, 10.0)
    world.hand_in(1, "1_Step-500.ckpt")
    world.at(20.0, lambda: world.publish(2))

    # Twice the steps take twice the time.
    name = world.waiter.wait(2, newest=1, steps=1000, since_s=0.0)

    assert name.number == 2
    first, second = world.looks_s[:2]
    assert first == 0.0
    assert second == pytest.approx(QUIET_SHARE * 20.0)
    assert world.now_s < 20.5


def test_a_worker_that_is_woken_looks_at_once_also_in_its_quiet_time(world):
    learn_from(world, 10.0, 10.0)
    world.hand_in(1, "1_Step-500.ckpt")
    world.at(2.0, lambda: world.publish(2))
    world.wakes_s = 2.0

    name = world.waiter.wait(2, newest=1, steps=1000, since_s=0.0)

    assert name.number == 2
    assert world.now_s == 2.0


def test_a_worker_that_is_woken_for_nothing_waits_on(world):
    world.publish(1)
    world.at(3.0, lambda: world.publish(2))
    world.wakes_s = 1.0

    assert world.waiter.wait(2, newest=1, steps=500, since_s=0.0).number == 2
    assert 3.0 <= world.now_s < 3.1


def test_where_several_workers_drive_the_learner_takes_as_much_longer(world):
    learn_from(world, 10.0, 10.0)
    world.waiter._workers = 4
    world.at(10.0, lambda: world.publish(2))

    world.waiter.wait(2, newest=1, steps=125, since_s=0.0)

    assert world.looks_s[1] == pytest.approx(QUIET_SHARE * 10.0)


@pytest.mark.parametrize("stalled_at", range(4))
def test_a_stalled_trainer_is_waited_for_once(world, stalled_at):
    """Whatever the trainer stood still for, the next checkpoints are waited for as ever."""
    learn_s = [0.3] * 8
    learn_s[stalled_at] = 20.0
    world.publish(0)
    waits_s = []
    for number, seconds in enumerate(learn_s, start=1):
        began_s = world.now_s
        counters = learned(seconds, 500)

        def publish(number=number, counters=counters) -> None:
            world.store.save(number, 500 * number, b"", counters=counters)

        world.at(began_s + seconds, publish)
        name = world.waiter.wait(number, newest=number - 1, steps=500, since_s=began_s)
        world.waiter.learn_from(world.store.record(str(name)))
        waits_s.append(world.now_s - began_s)

    del waits_s[stalled_at]
    assert max(waits_s) < 0.5


def test_a_learner_that_became_faster_is_not_waited_for_as_long_as_before(world):
    learn_from(world, 10.0, 10.0, 10.0, 1.0)
    world.at(1.0, lambda: world.publish(4))

    world.waiter.wait(4, newest=3, steps=500, since_s=0.0)

    assert world.now_s < 1.5


def test_a_checkpoint_that_says_nothing_of_learning_is_no_measure(world):
    world.waiter.learn_from(world.store.save(0, 0, b"", counters=Counters()))
    world.waiter.learn_from(world.store.save(1, 0, b""))
    world.at(1.0, lambda: world.publish(2))

    world.waiter.wait(2, newest=1, steps=500, since_s=0.0)

    assert world.now_s < 1.5


def test_what_the_worker_did_meanwhile_does_not_make_it_come_late(world):
    learn_from(world, 10.0, 10.0)
    world.at(10.0, lambda: world.publish(2))

    world.pause(8.0)  # evaluates
    world.waiter.wait(2, newest=1, steps=500, since_s=0.0)

    assert world.now_s < 10.5


def test_a_checkpoint_from_before_the_last_is_taken_too(world):
    world.publish(4)

    assert world.waiter.wait(8, newest=7, steps=0, since_s=0.0).number == 4


def test_the_end_of_the_training_ends_the_wait(world):
    world.publish(0)
    world.at(5.0, world.end)

    assert world.waiter.wait(1, newest=0, steps=10, since_s=0.0) is None


def test_the_end_of_an_earlier_start_does_not(world):
    world.end("an earlier start")
    world.at(5.0, lambda: world.publish(0))

    assert world.waiter.wait(0, newest=-1, steps=0, since_s=0.0).number == 0


def test_a_request_to_leave_is_obeyed_in_the_quiet_time_as_well(world):
    learn_from(world, 100.0, 100.0, steps=10)
    asked_s = 20.0
    world.at(asked_s, lambda: setattr(world, "stops", True))

    with pytest.raises(StopRequested):
        world.waiter.wait(2, newest=1, steps=10, since_s=world.now_s)

    assert world.now_s < asked_s + 1.0


def test_an_iteration_whose_rollouts_are_lost_is_driven_again(world):
    world.publish(0)
    world.publish(1)
    world.at(300.0, lambda: world.lose(1))

    name = world.waiter.wait(2, newest=1, steps=10, since_s=0.0)

    assert name.number == 1
    assert 300.0 <= world.now_s < 300.0 + 2 * RECHECK_S


def test_an_iteration_whose_rollouts_the_trainer_refuses_is_driven_again(world):
    world.publish(0)
    world.publish(1)
    world.hand_in(1, "1_Step-99.ckpt")

    assert world.waiter.wait(2, newest=1, steps=10, since_s=0.0).number == 1


def test_an_iteration_that_another_start_handed_in_over_ours_is_driven_again(world):
    world.publish(0)
    world.publish(1)
    manifest = Manifest(1, 0, "1_Step-100.ckpt", "an earlier start", ())
    world.bucket.put(keys.rollout_manifest(PREFIX, 1, 0), manifest.encode())

    assert world.waiter.wait(2, newest=1, steps=10, since_s=0.0).number == 1


def test_rollouts_of_the_checkpoint_before_are_as_good(world):
    world.publish(0)
    world.publish(1)
    world.hand_in(1, "0_Step-0.ckpt")
    world.at(100.0, lambda: world.publish(2))

    assert world.waiter.wait(2, newest=0, steps=10, since_s=0.0).number == 2


def test_rollouts_that_were_learned_from_are_not_lost(world):
    """The trainer publishes and deletes between the worker's two looks."""
    world.publish(0)
    seen = world.bucket.get

    def get(key: str) -> bytes:
        found = seen(key)
        if key == keys.coach_checkpoint(PREFIX) and world.now_s > RECHECK_S:
            world.bucket.get = seen
            world.publish(1)
            world.lose(0)
        return found

    world.bucket.get = get

    assert world.waiter.wait(1, newest=0, steps=10, since_s=0.0).number == 1


def test_a_worker_that_waits_for_its_first_checkpoint_misses_nothing(world):
    world.at(100.0, lambda: world.publish(0))

    assert world.waiter.wait(0, newest=-1, steps=0, since_s=0.0).number == 0


def test_a_bucket_elsewhere_is_asked_less_often_and_hardly_later():
    looks, ends = [], []
    for frugal in (False, True):
        world = World(frugal=frugal)
        world.publish(3)
        world.at(20.0, lambda world=world: world.publish(4))
        world.waiter.wait(4, 3, 500, 0.0)
        looks.append(len(world.looks_s))
        ends.append(world.now_s)

    assert looks[1] < looks[0] / 2
    assert ends[1] < 20.0 * 1.04
