"""Starts and stops the processes of a run."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from drcli.base import log_files
from drcli.exchange.job import Job
from drcli.exchange.log_places import log_file
from drcli.workers.pulse import STACKS_SIGNAL

TRAINER = "trainer"

SIMULATION_EXIT_S = 4.0
"""The trainer waits for workers, to score their evaluations."""

STACKS_S = 4.0
KILLED_S = 5.0


def start_process(
    job: Job, name: str, module: str, *arguments: str, gpus: str = ""
) -> subprocess.Popen[bytes]:
    """It outlives this one, with its own session and log, and reads the job from stdin."""
    chosen = {"CUDA_VISIBLE_DEVICES": gpus} if gpus else {}
    path = log_file(job.directory, job.config.model.prefix, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab") as log:  # append, because several processes may share it
        return job.spawn(
            # -P: a file of the working folder must not replace a module of the same name.
            [sys.executable, "-P", "-m", "drcli.base.start_module", module, *arguments],
            with_secrets=True,
            private=name == "supervisor",
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**chosen, log_files.VARIABLE: str(path)},
            cwd=job.directory,
            start_new_session=True,
        )


def end_process(process: subprocess.Popen[bytes], patience_s: float) -> bool:
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
    process: subprocess.Popen[bytes] | None = None
    started: float = 0.0
    finished: float | None = None
    restarts: int = 0
    quick_deaths: int = 0
    ended_by: str = ""
    left_out: bool = False

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
