"""What a supervisor does besides keeping its workers alive: uploads, watches, messages."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

from drcli.bucket.bucket import Bucket
from drcli.records.job import Job, WorkerExit
from drcli.run.journal import Journal
from drcli.run.outcome import Ending, Outcome
from drcli.run.periodic import Guard, Periodic
from drcli.run.warnings_board import WarningsBoard
from drcli.run.worker_processes import Child

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
    board: WarningsBoard


class Duty:
    """Base class of the duties; its methods do nothing.

    The `Schedule` calls `start` once, `check` every `check_s` in the supervisor's loop, where it
    must return at once, and `work` every `every_s` in a thread of its own, unless that is None
    when all have started. `finish` comes when the workers have exited and the run still owns its
    model, within `ending.left_s()`, and `after_release` when the lease is released. A failure
    never ends the run.

    Work at the end of a complete training is named by `pending`: before `finish` all of it,
    afterwards what was not done. The bucket keeps the names (`RunOutcome.left`), and
    `--resume-or-start` gives them to the duties of the next start as `ending.only`, with
    `start` and `finish` and without workers.
    """

    name = "duty"
    check_s = 0.0
    every_s: float | None = None

    def __init__(self, run: RunningTraining) -> None:
        self.run = run
        self.thread: Periodic | None = None

    @cached_property
    def bucket(self) -> Bucket:
        """That of its thread."""
        return self.run.open_bucket()

    def stop(self) -> None:
        """End its thread."""
        if self.thread is not None:
            self.thread.stop()

    def start(self) -> None:
        """Begin."""

    def check(self) -> Outcome | None:
        """Look around; an outcome ends the run."""

    def work(self) -> None:
        """Do what takes time."""

    def died(self, child: Child, code: int, exit_reason: WorkerExit | None) -> Outcome | None:
        """A worker has ended; it starts again with `child.arguments` unless `excluded`."""

    def end_facts(self) -> Mapping[str, object]:
        return {}

    def finish(self, ending: Ending) -> None:
        """Do what is left while the run still owns its model, within `ending.left_s()`."""

    def after_release(self, ending: Ending) -> None:
        """Do what needs no ownership, when everything is saved."""

    def end_result(self) -> Outcome | None:
        """What became of the work; a code other than 0 becomes the run's."""
        return None

    def pending(self, ending: Ending) -> Sequence[str]:
        return ()


class Schedule:
    """Calls duties when they are due; at the end in their order."""

    def __init__(self, duties: Sequence[Duty], clock: Callable[[], float] = time.monotonic) -> None:
        self._duties = [(duty, Guard(duty.name)) for duty in duties]
        self._clock = clock
        self._checked_s = [-float("inf")] * len(duties)

    def start(self) -> None:
        for duty, guard in self._duties:
            guard.call(duty.start)
        for duty, _ in self._duties:
            if duty.every_s is not None:
                duty.thread = Periodic(duty.name, duty.work, duty.every_s)
                duty.thread.start()

    def check(self) -> Outcome | None:
        """The first outcome ends the run."""
        now_s = self._clock()
        for k, (duty, guard) in enumerate(self._duties):
            if now_s - self._checked_s[k] >= duty.check_s:
                self._checked_s[k] = now_s
                if outcome := guard.call(duty.check):
                    return outcome
        return None

    def died(self, child: Child, code: int, exit_reason: WorkerExit | None) -> Outcome | None:
        return next(self._results(lambda duty: duty.died(child, code, exit_reason)), None)

    def end_facts(self) -> dict[str, object]:
        return {k: v for facts in self._results(lambda d: d.end_facts()) for k, v in facts.items()}

    def finish(self, ending: Ending) -> None:
        for duty, guard in self._duties:
            guard.call(partial(duty.finish, ending))
            duty.stop()

    def after_release(self, ending: Ending) -> None:
        """`finish` is not called if the model was lost."""
        for duty, guard in self._duties:
            guard.call(partial(duty.after_release, ending))
            duty.stop()

    def with_results(self, outcome: Outcome) -> Outcome:
        """Told only after `finish`, because some of the work may have failed."""
        for result in self._results(lambda duty: duty.end_result()):
            outcome = replace(
                outcome,
                code=outcome.code or result.code,
                message=f"{outcome.message} {result.message}".lstrip(),
                remedy=f"{outcome.remedy} {result.remedy}".strip(),
                complete=True,
            )
        return outcome

    def pending(self, ending: Ending) -> tuple[str, ...]:
        if ending.outcome.state != "finished":
            return ()
        return tuple(name for names in self._results(lambda d: d.pending(ending)) for name in names)

    def _results(self, call: Callable[[Duty], T | None]) -> Iterator[T]:
        for duty, guard in self._duties:
            found = guard.call(partial(call, duty))
            if found is not None:
                yield found
