"""Keeps a training alive: starts its workers, brings back what dies, ends it in good order."""

import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from types import FrameType

from drcli.base import log_files
from drcli.base.errors import DrError, OwnershipLost, StorageError
from drcli.checks.reward_timeout import words_of_stuck
from drcli.exchange.job import Job, LastWords
from drcli.exchange.run_record import RunRecord, State, WorkerRecord
from drcli.runs.launching import start_process
from drcli.runs.lease_renewal import LOOK_S, Renewal
from drcli.runs.log_upload import LogUpload
from drcli.runs.periodic import Periodic, within
from drcli.runs.run_logs import log_file
from drcli.runs.worker_processes import Child, dismiss
from drcli.store import lease
from drcli.store.bucket import Bucket
from drcli.store.model_prefix import newest_checkpoint

POLL_S = 0.2
"""How often the supervisor looks at its processes."""

SERVER_CHECK_S = 1.0

LEAVE_S = 10.0
"""How long the workers may take to leave after SIGTERM before they are killed."""

LOOK_PATIENCE_S, LOGS_PATIENCE_S, RELEASE_PATIENCE_S = 2.0, 9.0, 2.0
"""How long the bucket may take at the end: to say whether there is a checkpoint, for the last logs,
and for giving the prefix back. Whoever ends a process gives it 30 s."""

DISMISSED_S = 10.0
"""How long after a worker left in good order the trainer may take to end, as it then should."""

CRASHES: dict[int, str] = {
    signal.SIGSEGV: "a memory fault (signal SIGSEGV)",
    signal.SIGBUS: "a memory fault (signal SIGBUS)",
    signal.SIGILL: "an unknown instruction (signal SIGILL)",
    signal.SIGFPE: "an arithmetic fault (signal SIGFPE)",
    signal.SIGABRT: "an abort (signal SIGABRT)",
}
"""Signals by which a process ends through a fault of its own code, such as a reward function's."""

CRASH_S = 600.0
"""A worker that crashes within this time after a restart has done so quickly: it may drive for a
while each time until it comes to the same place."""

QUICK_DEATH_S = 20.0
"""A worker that lives shorter than this after a restart has died quickly."""

MAX_QUICK_DEATHS = 3
"""Quick deaths in a row, each by a failure of the worker's own, after which the run ends."""

MAX_QUICK_KILLS = 25
"""Quick deaths in a row by a signal from outside after which the run ends."""

INTERRUPTED, TERMINATED = 130, 143
"""Exit codes after Ctrl-C and after SIGTERM."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    code: int
    message: str
    remedy: str = ""


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
    ) -> None:
        """Begin.

        Args:
            job: What to train.
            bucket: Where.
            record: The note about the run on this machine.
            open_bucket: Makes a client of the bucket for another thread.
            renewal: Keeps the model prefix this training's own.
            revive_server: Starts the bucket's server where it does not answer.
            restart_server: Starts it anew in any case, if it is this machine's own.
        """
        self._job = job
        self._bucket = bucket
        self._record = record
        self._revive_server = revive_server
        self._restart_server = restart_server
        self._signal: int | None = None
        self._insisted = False
        self._silent = False
        self._log_lock = threading.Lock()
        self._renewal = renewal
        # Each in a thread of its own: none waits for another, and the loop for none.
        self._server = Periodic("server", revive_server, SERVER_CHECK_S, self._log)
        self._lease = Periodic("lease", renewal.step, LOOK_S, self._log)
        gpus = job.config.train.sagemaker_cuda_devices
        self._children = [Child("trainer", "drcli.workers.trainer", [], gpus)]
        for k in range(job.config.train.workers):
            self._children.append(Child(f"sim-{k}", "drcli.workers.sim", [str(k)]))
        self._server_began = 0.0
        names = ["supervisor", *(child.name for child in self._children)]
        self._logs = LogUpload(
            open_bucket,
            job.directory,
            job.config.model.prefix,
            job.config.log_max_mb,
            names,
            self._log,
        )

    def run(self) -> int:
        """Supervise until the training is over.

        Returns:
            The exit code of the command.
        """
        signal.signal(signal.SIGTERM, self._note)
        signal.signal(signal.SIGINT, self._note)
        outcome = Outcome(1, "The supervisor failed.", "Read its log with `dr-logs supervisor`.")
        try:
            self._server.start()
            self._lease.start()
            self._logs.start()
            for child in self._children:
                self._start(child)
            self._publish("running")
            outcome = self._watch()
        except DrError as error:
            outcome = Outcome(error.code, str(error), error.remedy)
        finally:
            self._end(outcome)
        return outcome.code

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if self._signal is not None:
            self._insisted = True
            for child in self._children:
                if child.running and child.process is not None:
                    child.process.kill()
        self._signal = number

    def _start(self, child: Child) -> None:
        LastWords.forget(self._job.folder, child.name)  # those of an earlier run explain nothing
        child.process = start_process(
            self._job, child.name, child.module, *child.arguments, gpus=child.gpus
        )
        child.started, child.dismissed = time.monotonic(), None
        self._log(f"{child.name} started, process {child.process.pid}.")

    def _watch(self) -> Outcome:
        """Look after everything until there is a reason to end."""
        while True:
            if self._signal is not None:
                name = signal.Signals(self._signal).name
                code = INTERRUPTED if self._signal == signal.SIGINT else TERMINATED
                return Outcome(code, f"Stopped by {name}.")
            if self._renewal.lost is not None:
                lost = self._renewal.lost
                return Outcome(lost.code, str(lost), lost.remedy)
            for child in self._children:
                if not child.running:
                    outcome = self._bury(child)
                    if outcome is not None:
                        return outcome
            time.sleep(POLL_S)

    def _bury(self, child: Child) -> Outcome | None:
        """Deal with a process that has ended.

        Returns:
            How the run ends, or None when it goes on.
        """
        assert child.process is not None
        code = child.process.returncode
        words = LastWords.find(self._job.folder, child.name) or words_of_stuck(
            code,
            log_file(self._job.directory, self._job.config.model.prefix, child.name),
            remedy="Correct reward_function.py, then go on with `dr-start-training --resume`, or "
            "start over with `-w`.",
        )
        if code == 0 and child.name == "trainer":
            return Outcome(0, words.message if words else "Training is complete.")
        if words is not None and words.final and code != 0:
            return Outcome(words.code, words.message, words.remedy)
        if code == 0:
            # The trainer sends the workers home before it ends itself.
            child.dismissed = child.dismissed or time.monotonic()
            if time.monotonic() < child.dismissed + DISMISSED_S:
                return None

        lived_s = time.monotonic() - child.started
        crash = CRASHES.get(-code)
        quick = lived_s < (QUICK_DEATH_S if crash is None else CRASH_S)
        child.quick_deaths = child.quick_deaths + 1 if quick else 0
        limit = MAX_QUICK_DEATHS if code > 0 or crash is not None else MAX_QUICK_KILLS
        if child.quick_deaths > limit:
            reason = words.message if words else f"{crash or f'exit code {code}'}."
            remedy = words.remedy if words else f"Read the reason with `dr-logs {child.name}`."
            died = f"{child.name} died {child.quick_deaths} times in a row: {reason}"
            return Outcome(
                words.code if words and words.code == StorageError.code else 5, died, remedy
            )
        how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
        self._log(f"{child.name} ended {how} after {lived_s:.0f} s; starting it again.")
        if words is not None and words.silent and self._server_began < child.started:
            # A server may answer whoever asks how it is, and still be stuck with some objects.
            restarted = self._server.ask(self._restart_server)
            while not restarted.wait(POLL_S) and self._signal is None:
                pass
            self._server_began = time.monotonic()
        child.restarts += 1
        self._start(child)
        self._publish("running")
        return None

    def _end(self, outcome: Outcome) -> None:
        """Send the workers away, bring the logs home, write down how it went."""
        lost = outcome.code == OwnershipLost.code
        for child in dismiss(self._children, 0.0 if lost else LEAVE_S):
            self._log(f"{child.name} did not leave in time and was killed.")
        self._lease.stop(wait_s=1.0)  # or it might write the lease after it was given back
        if outcome.code in (INTERRUPTED, TERMINATED):
            outcome = replace(outcome, remedy=self._way_on())
        self._log(f"{outcome.message} {outcome.remedy}".strip())
        if not lost:
            self._logs.finish(0.0 if self._silent else LOGS_PATIENCE_S, self._is_insisted)
            if not self._silent:
                within(RELEASE_PATIENCE_S, self._release, self._is_insisted)
        self._server.stop()
        state: State = "failed"
        if outcome.code == 0:
            state = "finished"
        elif outcome.code in (INTERRUPTED, TERMINATED):
            state = "stopped"
        self._record = self._with_workers().ended(
            state, outcome.code, outcome.message, outcome.remedy, time.time()
        )
        self._write_record()

    def _release(self) -> None:
        with suppress(DrError):
            lease.release(self._bucket, self._job.config.model.prefix, self._job.session)

    def _is_insisted(self) -> bool:
        return self._insisted

    def _way_on(self) -> str:
        """What to do after a stop, now that the workers have left whatever they had."""
        found: list[bool] = []

        def look() -> None:
            with suppress(DrError):
                newest = newest_checkpoint(self._bucket, self._job.config.model.prefix)
                found.append(newest is not None)

        within(LOOK_PATIENCE_S, look, self._is_insisted)
        self._silent = not found  # then nothing else is asked of the bucket, which would take long
        learned = not found or found[0]  # where it cannot be seen now, a resume tells
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
        except OSError as error:  # a full disk; what is shown of the run is older then
            self._log(f"{self._job.folder} cannot be written: {error}")

    def _log(self, text: str) -> None:
        """Write a line, from whichever thread; a full disk costs the line and nothing else."""
        path = log_file(self._job.directory, self._job.config.model.prefix, "supervisor")
        max_bytes = self._job.config.log_max_mb << 20
        with self._log_lock, suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.exists() and path.stat().st_size > log_files.part_bytes(max_bytes):
                os.close(log_files.rotate(path, max_bytes))
            with path.open("a", encoding="utf-8") as log:
                print(time.strftime("%Y-%m-%d %H:%M:%S"), text, file=log)
