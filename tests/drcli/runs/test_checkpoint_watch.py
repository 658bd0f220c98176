"""The last and the best checkpoint of a running training, as its duties see them."""

from drcli.base.errors import StorageError
from drcli.run.checkpoint_watch import CheckpointWatch
from memory_bucket import MemoryBucket
from unwatched import put_scores


class Counting(CheckpointWatch):
    """Counts its looks; the first ones can fail."""

    def __init__(self, failures: int = 0) -> None:
        super().__init__()
        self.looks = 0
        self._failures = failures

    def look(self) -> None:
        self.looks += 1
        if self.looks <= self._failures:
            raise StorageError("Nobody answers.", remedy="Wait.")


def test_it_sees_the_last_and_the_best():
    bucket = MemoryBucket()
    put_scores(bucket, "model", 1, 2)
    watch = CheckpointWatch()
    watch._open, watch._prefix = lambda: bucket, "model"

    watch.look_last()

    assert watch.last is not None
    assert watch.best is not None
    assert watch.last.name == watch.best.name == "2_Step-200.ckpt"


def test_several_duties_cost_one_look_at_the_end():
    watch = Counting()

    for _ in range(3):
        watch.look_last()

    assert watch.looks == 1


def test_a_look_that_failed_is_repeated_by_the_next_duty():
    watch = Counting(failures=1)

    for _ in range(3):
        watch.look_last()

    assert watch.looks == 2
