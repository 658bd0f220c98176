"""Keeps a training alive: starts its workers, restarts those that die, ends the run."""

import logging
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from types import FrameType
from typing import TypeVar

from drcli.base.errors import DrError, OwnershipLost, StorageError, WorkerDied
from drcli.base.log import get_logger
from drcli.checks.reward_timeout import exit_of_stuck
from drcli.exchange.job import Job, WorkerExit
from drcli.exchange.run_record import RunRecord, State, WorkerRecord
from drcli.runs.duty import Duty, RunningTraining
from drcli.runs.journal import Journal
from drcli.runs.lease_renewal import LOOK_S, Renewal
from drcli.runs.outcome import CTRL_C, TERMINATED, Ending, Outcome
from drcli.runs.periodic import Periodic, within
from drcli.runs.run_logs import LogUpload, log_file
from drcli.runs.worker_processes import TRAINER, Child, start_process, stop_workers
from drcli.store import lease
from drcli.store.bucket import Bucket
from drcli.store.model_prefix import newest_checkpoint

_logger = get_logger(__name__)

T = TypeVar("T")

POLL_S = 0.2
"""How often the supervisor looks at its processes."""

SERVER_CHECK_S = 1.0

EXIT_S = 10.0
"""How long the workers may take to exit after SIGTERM before they are killed."""

LOOK_PATIENCE_S, LOGS_PATIENCE_S, RELEASE_PATIENCE_S = 2.0, 9.0, 2.0
"""How long the bucket may take at the end: to find the newest checkpoint, to upload the last logs,
and to release the lease. A process that is asked to stop has 30 s."""

FINISHED_S = 10.0
"""How long the trainer may take to finish after a simulation worker has finished."""

CRASHES: dict[int, str] = {
    signal.SIGSEGV: "a memory fault (signal SIGSEGV)",
    signal.SIGBUS: "a memory fault (signal SIGBUS)",
    signal.SIGILL: "an unknown instruction (signal SIGILL)",
    signal.SIGFPE: "an arithmetic fault (signal SIGFPE)",
    signal.SIGABRT: "an abort (signal SIGABRT)",
}
"""Signals that end a process when its own code fails, such as a reward function."""

CRASH_S = 600.0
"""A crash within this time after a restart is a quick death: the worker may have to drive for a
while until it reaches the same place."""

QUICK_DEATH_S = 20.0
"""Any other death within this time after a restart is a quick death."""

MAX_QUICK_DEATHS = 3
"""How many quick deaths in a row a worker may have by its own fault."""

MAX_QUICK_KILLS = 25
"""The same for signals from outside."""


class Supervisor:
    """One run on this machine, from the first process to the last."""

    def __init__(
        self,
        job: Job,
        bucket: Bucket,
        record: RunRecord,
        renewal: Renewal,
        *,
        open_bucket: Callable[[], Bucket],
        revive_server: Callable[[], object],
        restart_server: Callable[[], object],
        duties: Sequence[Duty] = (),
    ) -> None:
        """Prepare the workers.

        Args:
            job: What to train.
            bucket: Holds the model.
            record: The record of the run on this machine.
            renewal: Keeps the lease of the model.
            open_bucket: Opens the bucket for another thread.
            revive_server: Starts the bucket's server if it does not answer.
            restart_server: Restarts it in any case, if it is ours.
            duties: What else is to be done, in the order in which it matters at the end.
        """
        self._job = job
        self._bucket = bucket
        self._record = record
        self._restart_server = restart_server
        self._signal: int | None = None
        self._hurried = False
        self._silent = False
        self._renewal = renewal
        # Each has its own thread, so that neither of them nor the loop waits for another.
        self._server = Periodic("server", revive_server, SERVER_CHECK_S)
        self._lease = Periodic("lease", renewal.step, LOOK_S)
        gpus = job.config.train.sagemaker_cuda_devices
        self._children = [Child(TRAINER, "drcli.workers.trainer", [], gpus)]
        for k in range(job.config.train.workers):
            self._children.append(Child(f"sim-{k}", "drcli.workers.sim", [str(k)]))
        self._server_began = 0.0
        names = ["supervisor", *(child.name for child in self._children)]
        self._duties = duties
        self._journal = Journal(job.config.model.prefix, job.term, job.session)
        self._running = RunningTraining(job, bucket, open_bucket, self._children, self._journal)
        self._logs = LogUpload(
            open_bucket, job.directory, job.config.model.prefix, job.config.log_max_mb, names
        )

    def run(self) -> int:
        """Supervise until the training is over; returns the exit code of the command."""
        signal.signal(signal.SIGTERM, self._note_signal)
        signal.signal(signal.SIGINT, self._note_signal)
        outcome = Outcome(1, "The supervisor failed.", "Read its log with `dr-logs supervisor`.")
        try:
            self._server.start()
            self._lease.start()
            self._logs.start()
            for child in self._children:
                self._start(child)
            self._publish("running")
            for duty in self._duties:
                self._attempt(duty, partial(duty.start, self._running))
            outcome = self._watch()
        except DrError as error:
            outcome = Outcome(error.code, str(error), error.remedy)
        finally:
            self._end(outcome)
        return outcome.code

    def _note_signal(self, number: int, _frame: FrameType | None) -> None:
        if self._signal is not None:
            self._hurried = True
            for child in self._children:
                if child.running and child.process is not None:
                    child.process.kill()
        self._signal = number

    def _start(self, child: Child) -> None:
        WorkerExit.delete(self._job.folder, child.name)  # that of an earlier run
        child.process = start_process(
            self._job, child.name, child.module, *child.arguments, gpus=child.gpus
        )
        child.started, child.finished, child.ended_by = time.monotonic(), None, ""
        _logger.info("%s started as process %d.", child.name, child.process.pid)

    def _watch(self) -> Outcome:
        """Watch the workers until there is a reason to end the run."""
        while True:
            if self._signal is not None:
                name = signal.Signals(self._signal).name
                code = CTRL_C if self._signal == signal.SIGINT else TERMINATED
                return Outcome(code, f"Stopped by {name}.")
            if self._renewal.lost is not None:
                lost = self._renewal.lost
                return Outcome(lost.code, str(lost), lost.remedy)
            for child in self._children:
                if not child.running and not child.left_out:
                    outcome = self._handle_exit(child)
                    if outcome is not None:
                        return outcome
            for duty in self._duties:
                outcome = self._attempt(duty, duty.check)
                if outcome is not None:
                    return outcome
            time.sleep(POLL_S)

    def _attempt(self, duty: Duty, call: Callable[[], T]) -> T | None:
        """Let a duty do something; if it fails, the training goes on without it."""
        try:
            return call()
        except DrError as error:
            _logger.warning("%s: %s %s", duty.name, error, error.remedy)
        except Exception as error:
            _logger.error("%s failed: %s", duty.name, error, exc_info=error)
        return None

    def _handle_exit(self, child: Child) -> Outcome | None:
        """Restart a worker that has exited, or return how the run ends."""
        assert child.process is not None
        code = child.process.returncode
        words = WorkerExit.read(self._job.folder, child.name) or exit_of_stuck(
            code,
            log_file(self._job.directory, self._job.config.model.prefix, child.name),
            remedy="Correct reward_function.py, then continue with `dr-start-training --resume`, "
            "or start over with `-w`.",
        )
        if code == 0 and child.name == TRAINER:
            return Outcome(0, words.message if words else "Training is complete.")
        if words is not None and words.final and code != 0:
            return Outcome(words.code, words.message, words.remedy)
        if code == 0:
            # The trainer marks the end of the training before it exits itself.
            child.finished = child.finished or time.monotonic()
            if time.monotonic() < child.finished + FINISHED_S:
                return None

        lived_s = time.monotonic() - child.started
        how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
        _logger.warning("%s ended %s after %.0f s.", child.name, how, lived_s)
        for duty in self._duties:
            if outcome := self._attempt(duty, partial(duty.died, child, code, words)):
                return outcome
        if child.left_out:
            child.process = None
            self._publish("running")
            return None
        if outcome := _died_too_often(child, code, lived_s, words):
            return outcome
        if words is not None and words.silent and self._server_began < child.started:
            # A server may answer a health check and still be stuck with some objects.
            restarted = self._server.ask(self._restart_server)
            while not restarted.wait(POLL_S) and self._signal is None:
                pass
            self._server_began = time.monotonic()
        child.restarts += 1
        self._start(child)
        self._publish("running")
        for duty in self._duties:
            self._attempt(duty, partial(duty.restarted, child))
        return None

    def _end(self, outcome: Outcome) -> None:
        """Stop the workers, save what is left, release the lease, and record the outcome."""
        lost = outcome.code == OwnershipLost.code
        _logger.info("Stopping; waiting for the workers to exit.")
        deadline_s = None
        if outcome.save_within_s is not None:
            deadline_s = time.monotonic() + outcome.save_within_s
        for child in stop_workers(self._children, 0.0 if lost else EXIT_S):
            _logger.warning("%s did not exit in time and was killed.", child.name)
        if outcome.state == "stopped":
            outcome = replace(outcome, remedy=self._how_to_continue())
        level = logging.ERROR if outcome.state == "failed" else logging.INFO
        _logger.log(level, "%s", f"{outcome.message} {outcome.remedy}".rstrip())
        ending = Ending(outcome, deadline_s, lambda: self._hurried)
        if not lost and not self._silent:
            # The lease is renewed meanwhile: these may take minutes.
            for duty in self._duties:
                self._attempt(duty, partial(duty.finish, ending))
        self._lease.stop(wait_s=1.0)  # or it might write the lease after its release
        if not lost:
            self._logs.finish(0.0 if self._silent else LOGS_PATIENCE_S, lambda: self._hurried)
            if not self._silent:
                within(RELEASE_PATIENCE_S, self._release, lambda: self._hurried)
        self._server.stop()
        self._record = self._with_workers().ended(
            outcome.state, outcome.code, outcome.message, outcome.remedy, time.time()
        )
        self._write_record()
        for duty in self._duties:
            self._attempt(duty, partial(duty.leave, ending))

    def _release(self) -> None:
        with suppress(DrError):
            lease.release(self._bucket, self._job.config.model.prefix, self._job.session)

    def _how_to_continue(self) -> str:
        """The remedy after a stop, once the workers have saved their work."""
        found: list[bool] = []

        def look() -> None:
            with suppress(DrError):
                newest = newest_checkpoint(self._bucket, self._job.config.model.prefix)
                found.append(newest is not None)

        within(LOOK_PATIENCE_S, look, lambda: self._hurried)
        self._silent = not found  # then nothing else is asked from the bucket
        learned = not found or found[0]  # if unknown, a resume finds out
        option = "--resume" if learned else "-w"
        return f"{'Continue' if learned else 'Start again'} with `dr-start-training {option}`."

    def _with_workers(self) -> RunRecord:
        workers = [
            WorkerRecord(c.name, c.process.pid if c.process else None, c.restarts)
            for c in self._children
        ]
        return replace(self._record, workers=workers)

    def _publish(self, state: State) -> None:
        self._record = replace(self._with_workers(), state=state)
        self._write_record()

    def _write_record(self) -> None:
        try:
            self._record.write(self._job.folder)
        except OSError as error:  # a full disk: `dr-status` then shows an older state
            _logger.error("%s cannot be written: %s", self._job.folder, error)


def _died_too_often(
    child: Child, code: int, lived_s: float, words: WorkerExit | None
) -> Outcome | None:
    """Count a quick death; after too many in a row, return how the run ends."""
    crash = CRASHES.get(-code)
    quick = lived_s < (QUICK_DEATH_S if crash is None else CRASH_S)
    child.quick_deaths = child.quick_deaths + 1 if quick else 0
    own_fault = code > 0 or crash is not None
    if child.quick_deaths <= (MAX_QUICK_DEATHS if own_fault else MAX_QUICK_KILLS):
        return None
    died = f"{child.name} died {child.quick_deaths} times in a row:"
    if words is None:
        remedy = f"Read the reason with `dr-logs {child.name}`."
        return Outcome(WorkerDied.code, f"{died} {crash or f'exit code {code}'}.", remedy)
    exit_code = words.code if words.code == StorageError.code else WorkerDied.code
    return Outcome(exit_code, f"{died} {words.message}", words.remedy)
