"""The last and the best checkpoint of a running training, as its duties see them."""

from drcli.base.errors import StorageError
from drcli.run.checkpoint_watch import CheckpointWatch
from drcli.run.duty import RunningTraining
from memory_bucket import MemoryBucket
from unwatched import job_of, put_scores, running


class Counting(CheckpointWatch):
    """Counts its looks; the first ones can fail."""

    def __init__(self, run: RunningTraining, failures: int = 0) -> None:
        super().__init__(run)
        self.looks = 0
        self._failures = failures

    def work(self) -> None:
        self.looks += 1
        if self.looks <= self._failures:
            raise StorageError("Nobody answers.", remedy="Wait.")


def test_it_sees_the_last_and_the_best(tmp_path):
    bucket = MemoryBucket()
    put_scores(bucket, "team/model", 1, 2)
    watch = CheckpointWatch(running(job_of(tmp_path), bucket))

    watch.look_last()

    assert watch.last is not None
    assert watch.best is not None
    assert watch.last.name == watch.best.name == "2_Step-200.ckpt"


def test_several_duties_cost_one_look_at_the_end(tmp_path):
    watch = Counting(running(job_of(tmp_path)))

    for _ in range(3):
        watch.look_last()

    assert watch.looks == 1


def test_a_look_that_failed_is_repeated_by_the_next_duty(tmp_path):
    watch = Counting(running(job_of(tmp_path)), failures=1)

    for _ in range(3):
        watch.look_last()

    assert watch.looks == 2
