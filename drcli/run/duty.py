"""What a supervisor does besides keeping its workers alive: uploads, watches, messages."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.bucket.bucket import Bucket
from drcli.records.job import Job, WorkerExit
from drcli.run.journal import Journal
from drcli.run.outcome import Ending, Outcome
from drcli.run.worker_processes import Child

_logger = get_logger(__name__)

T = TypeVar("T")


@dataclass(frozen=True)
class RunningTraining:
    """What a duty may use; `bucket` is fenced, for the supervisor's loop.

    `open_bucket` opens it for another thread; `job.term` is that of the lease.
    """

    job: Job
    bucket: Bucket
    open_bucket: Callable[[], Bucket]
    children: Sequence[Child]
    journal: Journal


class Duty:
    """Base class of the duties; its methods do nothing.

    The supervisor calls `start` once, `check` every 0.2 s, `finish` when the workers have
    exited and the run still owns its model, within `ending.left_s()`, and `leave` when the
    lease is released. `check` must return at once. A failure never ends the run.

    Work at the end of a complete training is named by `left`: before `finish` all of it,
    afterwards what was not done. The bucket keeps the names (`RunOutcome.left`), and
    `--resume-or-start` gives them to the duties of the next start as `ending.only`, with
    `start` and `finish` and without workers.
    """

    name = "duty"

    def start(self, run: RunningTraining) -> None:
        """Begin."""

    def check(self) -> Outcome | None:
        """Look around; an outcome ends the run."""

    def died(self, child: Child, code: int, words: WorkerExit | None) -> Outcome | None:
        """A worker has ended; it is started next, with `child.arguments`, unless `left_out`."""

    def end_facts(self) -> Mapping[str, object]:
        return {}

    def finish(self, ending: Ending) -> None:
        """Do what is left while the run still owns its model, within `ending.left_s()`."""

    def leave(self, ending: Ending) -> None:
        """Do what needs no ownership, when everything is saved."""

    def end_result(self) -> Outcome | None:
        """What became of the work; a code other than 0 becomes the run's."""
        return None

    def left(self, ending: Ending) -> Sequence[str]:
        return ()


def attempt(duty: Duty, call: Callable[[], T]) -> T | None:
    """A duty's failure is logged."""
    try:
        return call()
    except DrError as error:
        _logger.warning("%s: %s %s", duty.name, error, error.remedy)
    except Exception as error:
        _logger.error("%s failed: %s", duty.name, error, exc_info=error)
    return None
