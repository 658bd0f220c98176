"""The end of a run: stops its workers, saves what is left, and records the outcome.

The machine may vanish at any moment: first comes the outcome, then the newest checkpoint, which
the trainer still uploads, the logs, and the work of the duties, the most important first. Each has
what the earlier ones have left of the time. The lease is renewed until the end.
"""

import logging
import signal
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

from drcli.base.errors import DrError, OwnershipLost, StorageError, WorkerDied
from drcli.base.installation import installation_error
from drcli.base.log import get_logger
from drcli.bucket.bucket import Bucket
from drcli.model import lease
from drcli.model.model_prefix import delete_unlearned, newest_checkpoint
from drcli.model.model_store import ModelStore
from drcli.model.training_state import write_outcome
from drcli.records.job import Job, WorkerExit
from drcli.records.training_record import RunOutcome
from drcli.run.duty import Schedule
from drcli.run.journal import Journal
from drcli.run.outcome import INTERRUPTED, Ending, Outcome
from drcli.run.periodic import Periodic, within
from drcli.run.run_logs import LogUpload
from drcli.run.worker_processes import Child, stop_workers

_logger = get_logger(__name__)

EXIT_S = 10.0
LOOK_PATIENCE_S, LOGS_PATIENCE_S, RELEASE_PATIENCE_S = 2.0, 9.0, 2.0
"""A stopped process has a minute, and its best model half of it."""

RECORD_PATIENCE_S = 2.0
EXIT_SHARE, LOGS_SHARE, LAST_LINES_SHARE = 0.5, 0.5, 0.1
"""Of a limited time that is left: so a worker or server that hangs does not take all of it."""

LAST_LINES_S = 5.0
"""For what the duties have logged."""


class RunEnding:
    def __init__(
        self,
        job: Job,
        bucket: Bucket,
        *,
        open_bucket: Callable[[], Bucket],
        children: Sequence[Child],
        schedule: Schedule,
        journal: Journal,
        logs: LogUpload,
        lease_thread: Periodic,
        hurried: Callable[[], bool],
    ) -> None:
        self._job = job
        self._prefix = job.config.model.prefix
        self._bucket = bucket
        self._model = ModelStore(self._bucket, self._prefix)
        self._open_bucket = open_bucket
        self._children = children
        self._schedule = schedule
        self._journal = journal
        self._logs = logs
        self._lease = lease_thread
        self._hurried = hurried
        self._silent = False
        self._wanted: RunOutcome | None = None
        self._records: Bucket | None = None
        self._writing = threading.Lock()

    def end(self, outcome: Outcome) -> tuple[Outcome, Ending]:
        """Returns the outcome with its remedy, and the ending for `Duty.after_release`."""
        lost = outcome.code == OwnershipLost.code
        deadline_s = None
        if outcome.save_within_s is not None:
            deadline_s = time.monotonic() + outcome.save_within_s
        _logger.info("Stopping; waiting for the workers to exit.")
        if not lost and outcome.state != "finished":
            # A successor can go on from here, whatever comes next. Meanwhile the workers exit.
            self._record(outcome, (), wait_s=0.0)
        for child in stop_workers(self._children, 0.0 if lost else self._exit_s(outcome)):
            _logger.warning("%s did not exit in time and was killed.", child.name)
        if outcome.state == "stopped":
            outcome = replace(outcome, remedy=self._how_to_continue())
        ending = Ending(outcome, self._duties_end_s(deadline_s), self._hurried, self._job.end_work)
        level = logging.ERROR if outcome.state == "failed" else logging.INFO
        _logger.log(level, "%s", f"{outcome.message} {outcome.remedy}".rstrip())
        if not lost and not self._silent:
            if deadline_s is not None:
                self._logs.send(ending.left_s(LOGS_SHARE), self._hurried)
            self._save(outcome, ending)
            outcome = self._schedule.with_results(outcome)
            ending = replace(ending, outcome=outcome)
        if not lost:
            self._logs.finish(self._logs_s(deadline_s), self._hurried)
        self._lease.stop(wait_s=1.0)  # or it might write the lease after its release
        if not lost and not self._silent:
            within(RELEASE_PATIENCE_S, self._release, self._hurried)
        return outcome, ending

    def _exit_s(self, outcome: Outcome) -> float:
        if outcome.save_within_s is None:
            return EXIT_S
        return EXIT_SHARE * outcome.save_within_s

    def _duties_end_s(self, deadline_s: float | None) -> float | None:
        if deadline_s is None:
            return None
        left_s = max(0.0, deadline_s - time.monotonic())
        return deadline_s - min(LAST_LINES_S, LAST_LINES_SHARE * left_s) - RELEASE_PATIENCE_S

    def _logs_s(self, deadline_s: float | None) -> float:
        if self._silent:
            return 0.0
        if deadline_s is None:
            return LOGS_PATIENCE_S
        return max(1.0, deadline_s - time.monotonic() - RELEASE_PATIENCE_S)

    def _save(self, outcome: Outcome, ending: Ending) -> None:
        text = f"{outcome.message} {outcome.remedy}".rstrip()
        facts = self._schedule.end_facts()
        self._journal.note("end", text, state=outcome.state, code=outcome.code, **facts)
        self._record(outcome, self._schedule.pending(ending), RECORD_PATIENCE_S)
        if outcome.state == "finished":
            with suppress(DrError):  # they are deleted with the model at the latest
                delete_unlearned(self._model)
        self._schedule.finish(ending)
        self._record(outcome, self._schedule.pending(ending), RECORD_PATIENCE_S)
        self._journal.finish(RECORD_PATIENCE_S, self._hurried)

    def _record(self, outcome: Outcome, left: tuple[str, ...], wait_s: float) -> None:
        record = self._outcome(outcome, left)
        known = self._wanted and replace(self._wanted, ended_at=record.ended_at)
        if record == known:
            return
        self._wanted = record

        def write() -> None:
            with self._writing:
                if record is not self._wanted:
                    return  # a newer one waits
                try:
                    self._records = self._records or self._open_bucket()
                    write_outcome(ModelStore(self._records, self._prefix), record)
                except DrError as error:
                    _logger.warning("The outcome could not be recorded in the bucket: %s", error)

        within(wait_s, write, self._hurried)

    def _outcome(self, outcome: Outcome, left: tuple[str, ...]) -> RunOutcome:
        now = time.time()
        begun = self._job.begun or RunOutcome(self._job.session, "", now, now)
        return replace(
            begun,
            state=outcome.state,
            code=outcome.code,
            message=outcome.message,
            # That of a stop is known only when the workers have exited.
            remedy=outcome.remedy if outcome.code == INTERRUPTED else "",
            ended_at=now,
            stays_ended=outcome.stays_ended,
            left=left,
        )

    def _release(self) -> None:
        with suppress(DrError):
            lease.release(self._model, self._job.session)

    def _how_to_continue(self) -> str:
        found: list[bool] = []

        def look() -> None:
            with suppress(DrError):
                newest = newest_checkpoint(self._model)
                found.append(newest is not None)

        within(LOOK_PATIENCE_S, look, self._hurried)
        self._silent = not found  # then nothing else is asked from the bucket
        learned = not found or found[0]  # if unknown, a resume finds out
        option = "--resume" if learned else "-w"
        return f"{'Continue' if learned else 'Start again'} with `dr-start-training {option}`."


# Decides when a worker that dies again and again ends the run.


CRASHES: dict[int, str] = {
    signal.SIGSEGV: "a memory fault (signal SIGSEGV)",
    signal.SIGBUS: "a memory fault (signal SIGBUS)",
    signal.SIGILL: "an unknown instruction (signal SIGILL)",
    signal.SIGFPE: "an arithmetic fault (signal SIGFPE)",
    signal.SIGABRT: "an abort (signal SIGABRT)",
}
CRASH_S = 600.0
"""Until it reaches the same place."""

QUICK_DEATH_S = 20.0
MAX_QUICK_DEATHS = 3
MAX_QUICK_KILLS = 25


def died_too_often(
    child: Child, code: int, lived_s: float, exit_reason: WorkerExit | None
) -> Outcome | None:
    crash = CRASHES.get(-code)
    quick = lived_s < (QUICK_DEATH_S if crash is None else CRASH_S)
    child.quick_deaths = child.quick_deaths + 1 if quick else 0
    lost = exit_reason is not None and exit_reason.lost
    own_fault = (code > 0 or crash is not None) and not lost
    if child.quick_deaths <= (MAX_QUICK_DEATHS if own_fault else MAX_QUICK_KILLS):
        return None
    died = f"{child.name} died {child.quick_deaths} times in a row:"
    if exit_reason is None:
        if broken := installation_error():
            return Outcome(broken.code, f"{died} {broken}", broken.remedy)
        remedy = f"Read the reason with `dr-logs {child.name}`."
        return Outcome(WorkerDied.code, f"{died} {crash or f'exit code {code}'}.", remedy)
    exit_code = exit_reason.code if exit_reason.code == StorageError.code else WorkerDied.code
    return Outcome(exit_code, f"{died} {exit_reason.message}", exit_reason.remedy)
