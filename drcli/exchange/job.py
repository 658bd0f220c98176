"""The job that a launcher gives its worker processes, and why each of them ended."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from drcli.base.atomic_file import load_record, reserve, save_record
from drcli.base.errors import DrError, NoAnswer, SettingsError
from drcli.base.fingerprint import Fingerprint
from drcli.base.json_record import RecordError, from_json, json_default, parse_json
from drcli.config import secret_environment
from drcli.config.run_config import RunConfig
from drcli.exchange.evaluation_task import EvaluationTask
from drcli.exchange.journal_entry import JournalEntry
from drcli.exchange.policy_source import PolicySource
from drcli.exchange.run_outcome import RunOutcome
from drcli.exchange.stage import Stage

VERSION = 1
"""Of the format of a job; another version of this program may use another one."""

PROCESS_TUNING = {
    # Processes take turns on the same cores: a thread that spins for long while it waits for work,
    # which is OpenMP's habit, takes the core from the process that has work (measured on 2 cores:
    # updates during an evaluation took 5 times as long). Not to spin at all costs a fifth of the
    # learner's speed when it is alone.
    "GOMP_SPINCOUNT": "10000",
    # The C library gives large blocks back to the system at once, and every minibatch would get
    # its gradients in fresh pages again (measured: a fifth more samples/s without that).
    "MALLOC_MMAP_THRESHOLD_": str(1 << 30),
    "MALLOC_TRIM_THRESHOLD_": str(1 << 28),
    "THP_MEM_ALLOC_ENABLE": "1",
    # Cameras here draw by themselves; without this, to load MuJoCo looks for OpenGL: 0.2 s.
    "MUJOCO_GL": "disable",
}
"""Environment of the worker processes, unless the user's own says otherwise."""

FAST_LAPS = 5
"""Evaluation laps that show that a checkpoint drives fast laps, and not only one."""

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""What limits the threads of the libraries that compute: torch, NumPy, SciPy, numba."""

LOG_ENCODING = {"PYTHONIOENCODING": "utf-8:backslashreplace"}
"""Logs are UTF-8 in every locale; nothing that a reward function prints can end a worker."""


@dataclass(frozen=True)
class Job:
    """One start of a training or an evaluation.

    Attributes:
        session: Unique name of this start; rollouts of an earlier start have another one.
        seed: All random numbers of the run are derived from it.
        until_laps: Finish when an evaluation completes all its laps, and at least so many.
        until_lap_time_s: Finish only when each of these laps took at most so long, simulated
            seconds; without `until_laps`, there must be `FAST_LAPS`.
        max_minutes: Finish after so much wall time: of this start, or of all starts together if
            `whole_run`.
        folder: Where workers write their `WorkerExit`.
        launcher_pid: When this process ends, the workers end too.
        term: Of the lease that the supervisor has taken; 0 before.
        sources: What drives each racer of an evaluation; empty for checkpoints in PyTorch.
        whole_run: Whether any machine may continue the run with the same command. Then time counts
            over all starts, and SIGTERM is an interruption.
        ends_at: Finish at this time, in Unix seconds; None for no limit.
        begun: The record in the bucket of this start.
        end_work: If not empty, the training is complete, and only this work at its end is left.
        noted: What the start has to say in the journal.
        stages: Of the training, in order; empty without a curriculum.
        tasks: Evaluations that the worker processes of one command share.
        training: Id of the record of the training; empty if there is none.
        ray_workers: How many simulation workers Ray places; the settings have none then.
        ray_trainer: Whether Ray may place the trainer, as DR_RAY_TRAINER says.
        trainer: How often the trainer was started before, if an earlier process of it may still
            live on another machine: only the one with the highest number may write.
        ends_with: Number of the process whose end interrupts the training; 0 for none.
        began_s: When this start began, on the monotonic clock of its machine; 0 elsewhere.
        inputs: The racer's files that the start trains with, and its parameter files, by name.
            Those of the model are the ones that its newest checkpoint was trained with.
    """

    config: RunConfig
    session: str
    seed: int
    until_laps: int | None
    max_minutes: float | None
    folder: Path
    launcher_pid: int
    term: int = 0
    sources: tuple[PolicySource, ...] = ()
    whole_run: bool = False
    ends_at: float | None = None
    begun: RunOutcome | None = None
    end_work: tuple[str, ...] = ()
    noted: tuple[JournalEntry, ...] = ()
    stages: tuple[Stage, ...] = ()
    tasks: tuple[EvaluationTask, ...] = ()
    training: str = ""
    until_lap_time_s: float | None = None
    ray_workers: int = 0
    ray_trainer: bool = False
    trainer: int | None = None
    ends_with: int = 0
    began_s: float = 0.0
    inputs: Mapping[str, str] = field(default_factory=dict)

    @property
    def wanted_laps(self) -> int:
        """How many laps of an evaluation must be completed to finish; 0 if that is no goal."""
        return self.until_laps or (FAST_LAPS if self.until_lap_time_s is not None else 0)

    @property
    def files_sha256(self) -> str:
        """Hash of all `inputs`, which tells whether another start had the same ones."""
        return Fingerprint.of(json.dumps(dict(self.inputs), sort_keys=True).encode()).sha256

    @property
    def directory(self) -> Path:
        """The racer's working folder."""
        return self.config.directory

    def spawn(
        self,
        command: Sequence[str],
        *,
        with_secrets: bool = False,
        private: bool = False,
        **options: Any,
    ) -> "subprocess.Popen[bytes]":
        """Start a process that works on this job, which it reads with `Job.received`.

        The job travels through the standard input of the process: the racer's code may run there,
        and it could read the environment.

        Args:
            command: Program and arguments.
            with_secrets: Whether the process uses the bucket, and so needs the keys to it.
            private: Whether it sends messages, and so needs their secret addresses.
            options: Of `subprocess.Popen`; `env` adds to the environment.

        Raises:
            ValueError: The job has a number that the process could not read; nothing is started.
        """
        plain, _ = secret_environment.split(os.environ)
        secrets = secret_environment.all_secrets()
        if secrets:
            secret_environment.hide_process()
        limits = dict.fromkeys(THREAD_VARIABLES, str(self.config.train.threads))
        limits = limits if self.config.train.threads else {}
        options["env"] = {
            **PROCESS_TUNING,
            **plain,
            **limits,
            **LOG_ENCODING,
            **options.get("env", {}),
        }
        secrets = secrets if with_secrets else {}
        job = self if private else self.without_addresses()
        sent = {"version": VERSION, "job": asdict(job), "secrets": secrets}
        data = json.dumps(sent, default=json_default, allow_nan=False).encode()
        process = subprocess.Popen(command, stdin=subprocess.PIPE, **options)
        assert process.stdin is not None
        with suppress(BrokenPipeError), process.stdin as pipe:  # it may have ended already
            pipe.write(data)
        process.stdin = None
        return process

    def without_addresses(self) -> "Job":
        """The same for processes that send no messages and may run the racer's code."""
        public = self.config.unattended.replaced(webhook_url="", smtp_url="", on_end="")
        return replace(self, config=replace(self.config, unattended=public))

    @staticmethod
    def received() -> "Job":
        """Read the job of this process, once.

        Raises:
            SettingsError: The launcher is another version of this program.
        """
        data = sys.stdin.buffer.read()
        with Path(os.devnull).open("rb") as nothing:
            os.dup2(nothing.fileno(), sys.stdin.fileno())
        try:
            sent = parse_json(data)
            if not isinstance(sent, dict) or sent.get("version") != VERSION:
                raise RecordError(f"it is not written in version {VERSION}")
            secret_environment.keep(sent["secrets"])
            return from_json(Job, sent["job"])
        except (RecordError, KeyError) as error:
            raise SettingsError(
                f"This process cannot read its job: {error}.",
                remedy="Stop the run and start it again; drcli may have been updated in the "
                "meantime.",
            ) from error

    @staticmethod
    def received_or_exit() -> "Job":
        """Read the job of this process, or explain on standard error, its log, why it ends."""
        try:
            return Job.received()
        except SettingsError as error:
            sys.stderr.write(f"{error} {error.remedy}\n")
            raise SystemExit(error.code) from None


@dataclass(frozen=True)
class WorkerExit:
    """Why a worker process ended, for its supervisor.

    Attributes:
        code: Exit code for the command.
        final: Whether a new process would end the same way.
        silent: Whether the bucket's server did not answer.
        memory: Whether memory ran out.
        lost: Whether its machine is gone, which is not its own fault.
    """

    message: str
    remedy: str
    code: int
    final: bool = False
    silent: bool = False
    memory: bool = False
    lost: bool = False

    @staticmethod
    def of(error: DrError) -> "WorkerExit":
        """The record of an explained failure."""
        silent = isinstance(error, NoAnswer)
        return WorkerExit(str(error), error.remedy, error.code, error.final, silent)

    def write(self, folder: Path, name: str) -> None:
        """Write it for the worker of this name, unless the disk is full: the log says it too."""
        with suppress(OSError):
            save_record(_exit_file(folder, name), self)

    @staticmethod
    def read(folder: Path, name: str) -> "WorkerExit | None":
        """The record of the worker of this name; None if it does not exist or is damaged."""
        return load_record(WorkerExit, _exit_file(folder, name))

    @staticmethod
    def delete(folder: Path, name: str) -> None:
        """Delete the record of an earlier process of this name; the next one has room for it.

        The disk may be full when that process ends, and for that reason.
        """
        path = _exit_file(folder, name)
        path.unlink(missing_ok=True)
        with suppress(OSError):
            reserve(path)


def _exit_file(folder: Path, name: str) -> Path:
    return folder / f"{name}.last-words.json"
