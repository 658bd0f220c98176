"""What a supervisor does besides keeping its workers alive: uploads, watches, messages."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.exchange.job import Job, WorkerExit
from drcli.runs.journal import Journal
from drcli.runs.outcome import Ending, Outcome
from drcli.runs.worker_processes import Child
from drcli.store.bucket import Bucket

_logger = get_logger(__name__)

T = TypeVar("T")


@dataclass(frozen=True)
class RunningTraining:
    """What a duty may know and use of the run.

    Attributes:
        job: What is trained; `job.term` is that of the lease.
        bucket: Its bucket, fenced, for the thread of the supervisor's loop.
        open_bucket: Opens the fenced bucket for another thread.
        children: The trainer and the simulation workers.
        journal: Takes what happened.
    """

    job: Job
    bucket: Bucket
    open_bucket: Callable[[], Bucket]
    children: Sequence[Child]
    journal: Journal


class Duty:
    """Base class of the duties; its methods do nothing.

    The supervisor calls `start` once, `check` in every round of its loop (each 0.2 s), `finish`
    when the workers have exited and the run still owns its model, and `leave` at the very end, when
    the lease is released and the outcome is recorded. `check` must return at once: what takes
    longer belongs in a thread or a process. A failure in a duty is logged and never ends the run.

    Work at the end of a complete training that must not be lost is named by `left`: before `finish`
    everything that it is going to do, afterwards what it could not do. The bucket keeps these names
    (`RunOutcome.left`), and `--resume-or-start` gives them to the duties of the next start as
    `ending.only`, with `start` and `finish` and without workers.
    """

    name = "duty"
    """For the log."""

    def start(self, run: RunningTraining) -> None:
        """Begin."""

    def check(self) -> Outcome | None:
        """Look around; an outcome ends the run."""

    def died(self, child: Child, code: int, words: WorkerExit | None) -> Outcome | None:
        """Note that a worker has ended, with its exit code and what it wrote; it is started next.

        An outcome ends the run. `child.left_out` lets the run go on without the worker, and
        `child.arguments` are those of the next process.
        """

    def end_facts(self) -> Mapping[str, object]:
        """What the `end` entry of the journal should tell programs."""
        return {}

    def finish(self, ending: Ending) -> None:
        """Do what is left while the run still owns its model, within `ending.left_s()`."""

    def leave(self, ending: Ending) -> None:
        """Do what needs no ownership, when everything is saved."""

    def end_result(self) -> Outcome | None:
        """What became of the work at the end, once `finish` has returned; None without any.

        Its code is that of the run unless it is 0.
        """
        return None

    def left(self, ending: Ending) -> Sequence[str]:
        """Names of the work at this end that is not done yet."""
        return ()


def attempt(duty: Duty, call: Callable[[], T]) -> T | None:
    """Let a duty do something; if it fails, the training goes on without it."""
    try:
        return call()
    except DrError as error:
        _logger.warning("%s: %s %s", duty.name, error, error.remedy)
    except Exception as error:
        _logger.error("%s failed: %s", duty.name, error, exc_info=error)
    return None
