"""The job of worker processes, and why each ended."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from drcli.base.errors import DrError, NoAnswer, SettingsError
from drcli.base.files import load_record, reserve, save_record
from drcli.base.json_record import (
    Count,
    Fingerprint,
    JsonRecord,
    Pid,
    RecordError,
    SafeInt,
    Seconds,
    decode_json,
    json_default,
)
from drcli.config import secret_environment
from drcli.config.run_config import RunConfig
from drcli.records.evaluation_task import EvaluationTask, PolicySource
from drcli.records.run_record import JournalEntry
from drcli.records.stage import Stage
from drcli.records.training_record import RunOutcome

VERSION: Literal[1] = 1
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
"""The user's own environment comes first."""

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Of torch, NumPy, SciPy and numba."""

LOG_ENCODING = {"PYTHONIOENCODING": "utf-8:backslashreplace"}
"""No print of a reward function can end a worker."""


def environment(threads: int) -> dict[str, str]:
    """The environment of worker processes, without secrets; `threads` is DR_THREADS, 0 for any.

    If this process has secrets, it is hidden from now on.
    """
    if secret_environment.all_secrets():
        secret_environment.hide_process()
    plain, _ = secret_environment.split(os.environ)
    limits = dict.fromkeys(THREAD_VARIABLES, str(threads)) if threads else {}
    return {**PROCESS_TUNING, **plain, **limits, **LOG_ENCODING}


@dataclass(frozen=True)
class Job:
    """One start of a training or an evaluation.

    Attributes:
        session: Unique name; rollouts of another start have another one.
        seed: All random numbers are derived from it.
        max_minutes: Of this start, or of all if `whole_run`.
        launcher_pid: The workers end with it.
        term: Of the supervisor's lease; 0 before.
        sources: What drives in an evaluation; empty for checkpoints in PyTorch.
        whole_run: Any machine may continue the run; SIGTERM is an interruption.
        ends_at: Unix seconds.
        begun: This start's record in the bucket.
        end_work: Only this work at the end is left.
        ray_workers: Placed by Ray; the settings have none then.
        trainer: Earlier starts of the trainer; of those that still live, only the highest number
            may write.
        ends_with: Process whose end interrupts the training; 0: none.
        began_s: Monotonic, on its machine; 0 elsewhere.
        goals: What this start asks for, by the keys of `train.goals.OPTIONS`.
        inputs: The start's files by name; the model's are those of its newest checkpoint.
    """

    config: RunConfig
    session: str
    seed: SafeInt
    max_minutes: float | None
    folder: Path
    launcher_pid: Pid
    term: SafeInt = 0
    sources: tuple[PolicySource, ...] = ()
    whole_run: bool = False
    ends_at: Seconds | None = None
    begun: RunOutcome | None = None
    end_work: tuple[str, ...] = ()
    noted: tuple[JournalEntry, ...] = ()
    stages: tuple[Stage, ...] = ()
    tasks: tuple[EvaluationTask, ...] = ()
    training: str = ""
    ray_workers: SafeInt = 0
    ray_trainer: bool = False
    trainer: SafeInt | None = None
    ends_with: SafeInt = 0
    began_s: Seconds = 0.0
    goals: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)

    @property
    def files_sha256(self) -> str:
        return Fingerprint.of(json.dumps(dict(self.inputs), sort_keys=True).encode()).sha256

    @property
    def directory(self) -> Path:
        return self.config.directory

    def spawn(
        self,
        command: Sequence[str],
        *,
        with_secrets: bool = False,
        private: bool = False,
        **options: Any,
    ) -> "subprocess.Popen[bytes]":
        """Start a process that reads this job with `Job.received`.

        The job goes through standard input, as the racer's code could read the environment. The
        process gets the bucket's keys `with_secrets`, and the messages' addresses if `private`.

        Raises:
            ValueError: The process could not read a number; nothing is started.
        """
        options["env"] = environment(self.config.train.threads) | options.get("env", {})
        data = self.sent(with_secrets=with_secrets, private=private)
        process = subprocess.Popen(command, stdin=subprocess.PIPE, **options)
        assert process.stdin is not None
        with suppress(BrokenPipeError), process.stdin as pipe:  # it may have ended already
            pipe.write(data)
        process.stdin = None
        return process

    def sent(self, *, with_secrets: bool = False, private: bool = False) -> bytes:
        """What a process reads with `Job.received`; the arguments are those of `spawn`.

        Raises:
            ValueError: The job has a number that the process could not read.
        """
        secrets = secret_environment.all_secrets() if with_secrets else {}
        job = self if private else self.without_addresses()
        sent = asdict(_Sent(VERSION, job, secrets))
        return json.dumps(sent, default=json_default, allow_nan=False).encode()

    def without_addresses(self) -> "Job":
        """For processes that may run the racer's code."""
        public = self.config.unattended.replaced(webhook_url="", smtp_url="", on_end="")
        return replace(self, config=replace(self.config, unattended=public))

    @staticmethod
    def received() -> "Job":
        """Once; SettingsError if the launcher is another version."""
        data = sys.stdin.buffer.read()
        with Path(os.devnull).open("rb") as nothing:
            os.dup2(nothing.fileno(), sys.stdin.fileno())
        try:
            sent = decode_json(_Sent, data)
        except RecordError as error:
            raise SettingsError(
                f"This process cannot read its job: {error}.",
                remedy="Stop the run and start it again; drcli may have been updated in the "
                "meantime.",
            ) from error
        secret_environment.keep(sent.secrets)
        return sent.job

    @staticmethod
    def received_or_exit() -> "Job":
        """As `received`; logs a failure and ends."""
        try:
            return Job.received()
        except SettingsError as error:
            sys.stderr.write(f"{error} {error.remedy}\n")
            raise SystemExit(error.code) from None


@dataclass(frozen=True)
class _Sent:
    version: Literal[1]
    job: Job
    secrets: Mapping[str, str]


@dataclass(frozen=True)
class WorkerExit:
    """Why a worker process ended.

    Attributes:
        final: A new process would end the same way.
        silent: The bucket did not answer.
        lost: Its machine is gone.
    """

    message: str
    remedy: str
    code: SafeInt
    final: bool = False
    silent: bool = False
    memory: bool = False
    lost: bool = False

    @staticmethod
    def of(error: DrError) -> "WorkerExit":
        silent = isinstance(error, NoAnswer)
        return WorkerExit(str(error), error.remedy, error.code, error.final, silent)

    def write(self, folder: Path, name: str) -> None:
        """Not on a full disk: the log says it too."""
        with suppress(OSError):
            save_record(_exit_file(folder, name), self)

    @staticmethod
    def read(folder: Path, name: str) -> "WorkerExit | None":
        return load_record(WorkerExit, _exit_file(folder, name))

    @staticmethod
    def delete(folder: Path, name: str) -> None:
        """Room for the next, which may end because of a full disk."""
        path = _exit_file(folder, name)
        path.unlink(missing_ok=True)
        with suppress(OSError):
            reserve(path)


def _exit_file(folder: Path, name: str) -> Path:
    return folder / f"{name}.exit-reason.json"


# What a training and the workers that join it exchange.


@dataclass(frozen=True)
class JoinRecord(JsonRecord):
    """What a worker needs to join; written by each start.

    Attributes:
        versions: Of what decides how a car drives.
        tracks: SHA-256 of route files, by DR_WORLD_NAME.
        job: The `Job`, without secrets.
    """

    session: str
    versions: Mapping[str, str]
    tracks: Mapping[str, str]
    job: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MemberRecord(JsonRecord):
    """A joined simulation worker, which keeps renewing this.

    Readers compare no clocks: they see that it changes.

    Attributes:
        member: Unique name, kept in restarts.
        checkpoint: Newest seen; -1 before.
        drives: Present iteration; -1 for none.
        steps: Begun in it, of all its cars.
    """

    member: str
    session: str
    host: str
    pid: Pid
    beat: SafeInt = 0
    ready: bool = False
    checkpoint: SafeInt = -1
    failure: str = ""
    drives: SafeInt = -1
    steps: SafeInt = 0
    drive_s: Seconds = 0.0


@dataclass(frozen=True)
class WorkerShare:
    """One worker's episodes in an iteration; `first` counts since the training began."""

    worker: Count
    member: str
    first: Count
    count: Count


@dataclass(frozen=True)
class Shares:
    """Who drives which episodes, until the next `Shares`.

    Attributes:
        version: Counts them.
        checkpoint: Published with them.
        iteration: The first that nobody drives without knowing that checkpoint; episodes count
            from there.
        workers: The first also evaluates.
    """

    version: SafeInt
    checkpoint: SafeInt
    iteration: SafeInt
    workers: tuple[WorkerShare, ...] = ()

    def of(self, worker: int) -> WorkerShare | None:
        return next((share for share in self.workers if share.worker == worker), None)


@dataclass(frozen=True)
class SharesRecord(JsonRecord):
    """The newest few shares; only the trainer writes them."""

    session: str
    numbers: Mapping[str, SafeInt] = field(default_factory=dict)
    newest: tuple[Shares, ...] = ()

    def at(self, iteration: int) -> Shares | None:
        fits = [shares for shares in self.newest if shares.iteration <= iteration]
        return fits[-1] if fits else None
