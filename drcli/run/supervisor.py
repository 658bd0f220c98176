"""Keeps a training alive: starts and restarts its workers."""

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from types import FrameType

from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.base.processes import handle
from drcli.bucket.bucket import Bucket
from drcli.metrics.open_sinks import tensorboard_folder
from drcli.records.job import Job, WorkerExit
from drcli.records.run_record import RunRecord, State, StopRequest, WorkerRecord, log_file
from drcli.rewards.source import exit_of_stuck
from drcli.run.duty import Duty, RunningTraining, Schedule
from drcli.run.interruption_watch import LEASE_POLL_S, Renewal
from drcli.run.journal import Journal
from drcli.run.outcome import CTRL_C, TERMINATED, Outcome, interrupted
from drcli.run.periodic import Periodic
from drcli.run.run_ending import RunEnding, died_too_often
from drcli.run.run_logs import LogUpload
from drcli.run.warnings_board import WarningsBoard
from drcli.run.worker_processes import TRAINER, Child, start_process

_logger = get_logger(__name__)

POLL_S = 0.2
SERVER_CHECK_S = 1.0

FINISHED_S = 10.0
SIGTERM_MARGIN_S = 3.0
"""Before the end of DR_SIGTERM_GRACE_SECONDS."""


class Supervisor:
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
        duties: Callable[[RunningTraining], Sequence[Duty]] = lambda run: (),
    ) -> None:
        self._job = job
        self._bucket = bucket
        self._record = record
        self._restart_server = restart_server
        self._signal: int | None = None
        self._hurried = False
        self._renewal = renewal
        # Each has its own thread, so that neither of them nor the loop waits for another.
        self._server = Periodic("server", revive_server, SERVER_CHECK_S)
        self._lease = Periodic("lease", renewal.step, LEASE_POLL_S)
        gpus = job.config.train.sagemaker_cuda_devices
        trainer = "drcli.run.launchers.placed_trainer" if job.ray_trainer else "drcli.train.trainer"
        self._children = [Child(TRAINER, trainer, [], gpus)]
        for k in range(job.config.train.workers):
            gpus = job.config.train.robomaker_cuda_devices
            self._children.append(Child(f"sim-{k}", "drcli.train.sim", [str(k)], gpus))
        if job.ray_workers:
            self._children.append(Child("ray", "drcli.run.launchers.ray_workers", []))
        self._server_began = 0.0
        names = ["supervisor", *(child.name for child in self._children)]
        if job.end_work:
            self._children = []
        self._open_bucket = open_bucket
        self._journal = Journal(job.config.model.prefix, job.term, job.session, job.noted)
        board = WarningsBoard(job.folder, job.session, self._journal)
        running = RunningTraining(job, bucket, open_bucket, self._children, self._journal, board)
        self._schedule = Schedule(duties(running))
        prefix = job.config.model.prefix
        writes_events = job.config.figures.tensorboard
        events = tensorboard_folder(job.directory, prefix) if writes_events else None
        self._logs = LogUpload(open_bucket, job.directory, prefix, job.config.logs, names, events)

    def run(self) -> int:
        """Returns the exit code of the command."""
        handle(self._note_signal)
        outcome = Outcome(1, "The supervisor failed.", "Read its log with `dr-logs supervisor`.")
        try:
            self._server.start()
            self._lease.start()
            self._logs.start()
            self._journal.start(self._open_bucket)
            for child in self._children:
                self._start(child)
            self._publish("running")
            self._schedule.start()
            outcome = self._watch()
        except DrError as error:
            outcome = Outcome(error.code, str(error), error.remedy)
        finally:
            outcome = self._end(outcome)
        return outcome.code

    def _note_signal(self, number: int, _frame: FrameType | None) -> None:
        if self._signal is not None:
            if number == signal.SIGHUP:  # a shell repeats that of its terminal
                return
            self._hurried = True
            for child in self._children:
                if child.running and child.process is not None:
                    child.process.kill()
        self._signal = number

    def _start(self, child: Child) -> None:
        WorkerExit.delete(self._job.folder, child.name)  # that of an earlier run
        job = self._job
        if job.ray_trainer and child.name == TRAINER:
            job = replace(job, trainer=child.restarts)
            self._forbid_earlier_trainers(child.restarts)
        child.process = start_process(
            job, child.name, child.module, *child.arguments, gpus=child.gpus
        )
        child.started, child.finished, child.ended_by = time.monotonic(), None, ""
        _logger.info("%s started as process %d.", child.name, child.process.pid)

    def _forbid_earlier_trainers(self, number: int) -> None:
        """One may live on a machine that is cut off."""
        if number:
            written = self._lease.ask(partial(self._renewal.begin_trainer, number))
            while not written.wait(POLL_S) and self._signal is None:
                pass

    def _watch(self) -> Outcome:
        while True:
            if self._signal is not None:
                return self._stopped_by(signal.Signals(self._signal))
            if not RunRecord.is_in(self._job.folder):
                self._write_record()  # or no command would know of this run
            if self._renewal.lost is not None:
                lost = self._renewal.lost
                return Outcome(lost.code, str(lost), lost.remedy)
            for child in self._children:
                if not child.running and not child.excluded:
                    outcome = self._handle_exit(child)
                    if outcome is not None:
                        return outcome
            if outcome := self._schedule.check():
                return outcome
            if self._job.end_work:
                return Outcome(0, self._job.begun.message if self._job.begun else "")
            time.sleep(POLL_S)

    def _stopped_by(self, number: signal.Signals) -> Outcome:
        """A person sent the signal, or a scheduler takes the machine."""
        if number == signal.SIGINT:
            return Outcome(CTRL_C, "Stopped by Ctrl-C.", stays_ended=True)
        if StopRequest.is_for(self._job.session, self._job.folder):
            return Outcome(TERMINATED, "Stopped on request.", stays_ended=True)
        unattended = self._job.config.unattended
        save_s = unattended.sigterm_grace_seconds - SIGTERM_MARGIN_S
        if not self._job.whole_run:
            return Outcome(TERMINATED, f"Stopped by {number.name}.", save_within_s=save_s)
        self._journal.note("notice", f"{number.name} came.", source="signal", what="interruption")
        return interrupted(
            f"Interrupted by {number.name}.",
            save_s,
            continues=unattended.continue_on_spot_interruption,
        )

    def _handle_exit(self, child: Child) -> Outcome | None:
        assert child.process is not None
        code = child.process.returncode
        exit_reason = WorkerExit.read(self._job.folder, child.name) or exit_of_stuck(
            code,
            log_file(self._job.directory, self._job.config.model.prefix, child.name),
        )
        if code == 0 and child.name == TRAINER and exit_reason is not None:
            return Outcome(0, exit_reason.message)
        if exit_reason is not None and exit_reason.final and code != 0:
            return Outcome(exit_reason.code, exit_reason.message, exit_reason.remedy)
        if code == 0 and child.name != TRAINER:
            # The trainer marks the end of the training before it exits itself.
            child.finished = child.finished or time.monotonic()
            if time.monotonic() < child.finished + FINISHED_S:
                return None

        lived_s = time.monotonic() - child.started
        how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
        ended = f"{child.name} ended {how} after {lived_s:.0f} s."
        _logger.warning("%s", ended)
        why = exit_reason.message if exit_reason is not None else ""
        self._journal.note("fault", f"{ended} {why}".rstrip(), worker=child.name, code=code)
        if outcome := self._schedule.died(child, code, exit_reason):
            return outcome
        if child.excluded:
            child.process = None
            self._publish("running")
            return None
        if outcome := died_too_often(child, code, lived_s, exit_reason):
            return outcome
        if exit_reason is not None and exit_reason.silent and self._server_began < child.started:
            # A server may answer a health check and still be stuck with some objects.
            restarted = self._server.ask(self._revive)
            while not restarted.wait(POLL_S) and self._signal is None:
                pass
            self._server_began = time.monotonic()
        child.restarts += 1
        self._start(child)
        again = f"{child.name} was started again (restart {child.restarts})."
        self._journal.note("recovery", again, worker=child.name, restarts=child.restarts)
        self._publish("running")
        return None

    def _revive(self) -> None:
        self._restart_server()
        self._journal.note("recovery", "The server of the bucket was started again.")

    def _end(self, outcome: Outcome) -> Outcome:
        self._record = replace(self._record, ending=True)
        self._write_record()
        run_ending = RunEnding(
            self._job,
            self._bucket,
            open_bucket=self._open_bucket,
            children=self._children,
            schedule=self._schedule,
            journal=self._journal,
            logs=self._logs,
            lease_thread=self._lease,
            hurried=lambda: self._hurried,
        )
        outcome, ending = run_ending.end(outcome)
        self._server.stop()
        self._record = self._with_workers().ended(
            outcome.state, outcome.code, outcome.message, outcome.remedy, time.time()
        )
        self._write_record()
        self._schedule.after_release(ending)
        return outcome

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
