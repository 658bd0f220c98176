"""Starts and stops the processes of a run."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from drcli.base import early_process
from drcli.base import log as log_files
from drcli.base.early_process import ChildProcess
from drcli.base.errors import DrError, WorkerDied
from drcli.base.installation import installation_error
from drcli.base.processes import exists
from drcli.bucket.connect import open_running_bucket
from drcli.config.run_config import RunConfig
from drcli.model import keys
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore
from drcli.records.job import Job
from drcli.records.run_record import RunRecord, log_file, run_folder, running_evaluations
from drcli.records.trace import STEP_S, read_csv
from drcli.run.read_logs import text_tail
from drcli.workers.heartbeat_thread import STACKS_SIGNAL

TRAINER = "trainer"

SIMULATION_EXIT_S = 4.0
"""The trainer waits for workers, to score their evaluations."""

STACKS_S = 4.0
KILLED_S = 5.0


def start_process(
    job: Job, name: str, module: str, *arguments: str, gpus: str = ""
) -> ChildProcess:
    """It outlives this one, with its own session and log, and reads the job from stdin."""
    chosen = {"CUDA_VISIBLE_DEVICES": gpus} if gpus else {}
    path = log_file(job.directory, job.config.model.prefix, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    chosen[log_files.VARIABLE] = str(path)
    private = name == "supervisor"
    with path.open("ab") as log:  # append, because several processes may share it
        if early := early_process.taken(module):
            order = early_process.Order(module, arguments, str(path), chosen)
            return early.give(order, job.sent(with_secrets=True, private=private))
        return job.spawn(
            # -P: a file of the working folder must not replace a module of the same name.
            [sys.executable, "-P", "-m", "drcli.base.start_module", module, *arguments],
            with_secrets=True,
            private=private,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=chosen,
            cwd=job.directory,
            start_new_session=True,
        )


def end_process(process: ChildProcess, patience_s: float) -> bool:
    """Whether it exited by itself."""
    process.terminate()
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    return True


@dataclass
class Child:
    name: str
    module: str
    arguments: list[str]
    gpus: str = ""
    process: ChildProcess | None = None
    started: float = 0.0
    finished: float | None = None
    restarts: int = 0
    quick_deaths: int = 0
    ended_by: str = ""
    excluded: bool = False

    @property
    def running(self) -> bool:
        return self.process is not None and self.process.poll() is None

    def ask_stacks(self) -> None:
        if self.process is not None and self.running and STACKS_SIGNAL is not None:
            with suppress(ProcessLookupError):
                os.kill(self.process.pid, STACKS_SIGNAL)

    def kill_for(self, reason: str) -> None:
        if self.process is not None and self.running:
            self.ended_by = reason
            self.process.kill()

    def give_up(self) -> None:
        """Count a killed process as ended even if the kernel has not removed it.

        After SIGKILL none of its code runs again.
        """
        if self.process is not None and self.running:
            self.process.returncode = -signal.SIGKILL

    def kill(self) -> None:
        if self.process is not None and self.running:
            self.process.kill()
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(KILLED_S)
            self.give_up()


def stop_workers(children: Sequence[Child], patience_s: float) -> list[Child]:
    """The simulation first; returns those that had to be killed."""
    began_s = time.monotonic()
    if patience_s > 0.0:
        simulation = [child for child in children if child.name != TRAINER]
        _terminate(simulation)
        _wait(simulation, began_s + min(SIMULATION_EXIT_S, patience_s))
        _terminate(children)
        _wait(children, began_s + patience_s)
    late = [child for child in children if child.running]
    for child in late:
        child.kill()
    return late


def _terminate(children: Iterable[Child]) -> None:
    for child in children:
        if child.running and child.process is not None:
            child.process.terminate()


def _wait(children: Iterable[Child], deadline_s: float) -> None:
    for child in children:
        if child.process is not None:
            with suppress(subprocess.TimeoutExpired):
                child.process.wait(max(0.0, deadline_s - time.monotonic()))


# The worker processes of a run on this machine, and how fast one drives.


@dataclass(frozen=True)
class Process:
    """A worker of a running training or evaluation."""

    name: Annotated[str, '"trainer", "sim-0", "sim-1", ... or "evaluation".']
    pid: Annotated[int, "Its process."]
    alive: Annotated[bool, "Whether that process runs; its supervisor may be about to restart it."]
    log: Annotated[str, "Path of its log file."]


@dataclass(frozen=True)
class ProcessReport:
    """The result of `dr-find-sagemaker` and `dr-find-robomaker`."""

    processes: Annotated[list[Process], "The workers that run."] = field(default_factory=list)


@dataclass(frozen=True)
class SpeedReport:
    """The newest iteration that a simulation worker has finished."""

    worker: Annotated[str, '"sim-0", "sim-1", ...']
    pid: Annotated[int, "Its process."]
    iteration: Annotated[int | None, "Number of the iteration, None before the first."] = None
    steps: Annotated[int, "Steps that all its cars together drove in it."] = 0
    steps_per_s: Annotated[float | None, "Steps per second of wall time while it drove."] = None
    real_time_factor: Annotated[
        float | None, "Simulated seconds of all cars together, per second of wall time."
    ] = None

    def __str__(self) -> str:
        if self.steps_per_s is None or self.real_time_factor is None:
            return f"{self.worker} has not finished an iteration yet."
        return (
            f"{self.worker}: {self.steps_per_s:.0f} steps/s, {self.real_time_factor:.0f} x real "
            f"time, in the {self.steps:,} steps of iteration {self.iteration}."
        )


def trainers(directory: Path, run_id: int) -> list[Process]:
    return _workers(directory, run_id, TRAINER)


def simulations(directory: Path, run_id: int) -> list[Process]:
    return _workers(directory, run_id, "sim-")


def evaluations(directory: Path, run_id: int) -> list[Process]:
    return [
        _process(directory, record.prefix, "evaluation", record.worker_pid)
        for record in running_evaluations(directory, run_id)
    ]


def speed_of(process: Process, config: RunConfig) -> SpeedReport:
    unknown = SpeedReport(process.name, process.pid)
    record = RunRecord.read(run_folder(config.directory, config.run_id))
    if record is None:
        return unknown
    bucket = open_running_bucket(record.storage_at_start(config.storage, config.directory))
    if bucket is None:
        return unknown
    history = read_history(ModelStore(bucket, record.prefix))
    if not history:
        return unknown
    number = int(process.name.removeprefix("sim-"))
    iteration = history[-1].iteration
    places = keys.training_traces(record.prefix, iteration, number)
    key = next(filter(bucket.exists, places), None)
    if key is None:
        return unknown
    episodes = read_csv(bucket.get(key))
    rows = sum(episode.steps + 1 for episode in episodes)
    seconds = [at for episode in episodes for at in episode.wall_s]
    if not seconds or max(seconds) <= min(seconds):
        return unknown
    # There is one row more than there are pauses between rows.
    steps_per_s = (rows - 1) / (max(seconds) - min(seconds))
    factor = steps_per_s * STEP_S
    return SpeedReport(process.name, process.pid, iteration, rows, steps_per_s, factor)


def _workers(directory: Path, run_id: int, kind: str) -> list[Process]:
    record = RunRecord.read(run_folder(directory, run_id))
    if record is None or not record.alive:
        return []
    return [
        _process(directory, record.prefix, worker.name, worker.pid)
        for worker in record.workers
        if worker.name.startswith(kind) and worker.pid is not None
    ]


def _process(directory: Path, prefix: str, name: str, pid: int) -> Process:
    return Process(name, pid, exists(pid), str(log_file(directory, prefix, name)))


# Says why a process started in the background is not there.


READY_TIMEOUT_S = 60.0
_TAIL_BYTES = 4000

_LONGEST_LINE = 300


def log_bytes(log: Path) -> int:
    try:
        return log.stat().st_size
    except OSError:
        return 0


def failed_start(what: str, code: int | None, log: Path, earlier_bytes: int) -> DrError:
    """The error of a process that exited (`code`), or was not ready in time (None).

    `earlier_bytes` of its log are from before the start.
    """
    if code is None:
        return WorkerDied(
            f"{what} did not start: it was not ready within {READY_TIMEOUT_S:g} seconds.",
            remedy=f"Try again when the machine is less busy. Its log is {log}.",
        )
    return installation_error() or WorkerDied(
        f"{what} did not start: its process exited (exit code {code}). "
        f"The last line of its log is: {_last_line(log, earlier_bytes)}",
        remedy=f"Read the reason in {log}.",
    )


def _last_line(log: Path, earlier_bytes: int) -> str:
    try:
        # A log that got shorter was begun anew.
        if log.stat().st_size == earlier_bytes:
            return "(nothing)"
        lines = [line for line in text_tail(log, _TAIL_BYTES).splitlines() if line.strip()]
    except OSError:
        return "(nothing)"
    return lines[-1].strip()[:_LONGEST_LINE] if lines else "(nothing)"
