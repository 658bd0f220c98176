"""What a launcher tells its worker processes, and what they tell it when they fail."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from drcli.base.atomic_file import read_json, write_json
from drcli.base.errors import DrError, NoAnswer, SettingsError
from drcli.base.json_record import Misfit, built, parsed, written
from drcli.config import secret_environment
from drcli.config.settings import RunConfig

VERSION = 1
"""Of the form in which a job travels; another one comes from another version of this program."""

PROCESS_TUNING = {
    # Processes take turns on the same cores: a thread that spins for long while it waits for work,
    # which is OpenMP's habit, takes the core from the process that has work (measured on 2 cores:
    # updates beside an evaluation took 5 times as long). Not to spin at all costs a fifth of the
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

LOG_ENCODING = {"PYTHONIOENCODING": "utf-8:backslashreplace"}
"""Logs are UTF-8 in every locale; nothing that a reward function prints can end a worker."""


@dataclass(frozen=True)
class Job:
    """One start of a training or an evaluation.

    Attributes:
        config: What the racer's settings say of it.
        session: Unique name of this start; rollouts of an earlier start never carry it.
        seed: What all random numbers of the run are derived from.
        until_laps: Finish once an evaluation completes all its laps, at least so many.
        max_minutes: Finish after so much wall time.
        folder: Where processes leave their last words on this machine.
        launcher_pid: The process whose end ends the workers too.
        term: Of the lease that its supervisor has taken; 0 before.
    """

    config: RunConfig
    session: str
    seed: int
    until_laps: int | None
    max_minutes: float | None
    folder: Path
    launcher_pid: int
    term: int = 0

    @property
    def directory(self) -> Path:
        """The racer's working folder."""
        return self.config.directory

    def spawn(
        self, command: Sequence[str], *, with_secrets: bool = False, **options: Any
    ) -> "subprocess.Popen[bytes]":
        """Start a process that works on this job, which it gets by `Job.received`.

        The job travels through a pipe, which is the standard input of the process, because code of
        the racer's may run there: what the environment holds, that code can read.

        Args:
            command: Program and arguments.
            with_secrets: Whether the process has to use the bucket, and so the keys to it.
            options: Of `subprocess.Popen`; `env` adds to the environment.
        """
        plain, _ = secret_environment.split(os.environ)
        secrets = secret_environment.all_secrets()
        if secrets:
            secret_environment.hide_process()
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            **{
                **options,
                "env": {**PROCESS_TUNING, **plain, **LOG_ENCODING, **options.get("env", {})},
            },
        )
        handed = {
            "version": VERSION,
            "job": asdict(self),
            "secrets": secrets if with_secrets else {},
        }
        assert process.stdin is not None
        with suppress(BrokenPipeError), process.stdin as pipe:  # it may have ended already
            pipe.write(json.dumps(handed, default=written).encode())
        process.stdin = None
        return process

    @staticmethod
    def received() -> "Job":
        """The job that the launcher of this process gave it; read once.

        Raises:
            SettingsError: The launcher is another version of this program.
        """
        data = sys.stdin.buffer.read()
        with Path(os.devnull).open("rb") as nothing:
            os.dup2(nothing.fileno(), sys.stdin.fileno())
        try:
            handed = parsed(data)
            if not isinstance(handed, dict) or handed.get("version") != VERSION:
                raise Misfit(f"it is not written in version {VERSION}")
            secret_environment.keep(handed["secrets"])
            return built(Job, handed["job"])
        except (Misfit, KeyError) as error:
            raise SettingsError(
                f"This process cannot read the job that its launcher gave it: {error}.",
                remedy="Stop the run and start it again; drcli may have been updated meanwhile.",
            ) from error


@dataclass(frozen=True)
class LastWords:
    """Why a worker process ended.

    Attributes:
        code: The exit code that the command should end with.
        final: Whether another process would end the same way.
        silent: Whether the bucket's server did not answer.
    """

    message: str
    remedy: str
    code: int
    final: bool = False
    silent: bool = False

    @staticmethod
    def of(error: DrError) -> "LastWords":
        """What an explained failure has to say."""
        silent = isinstance(error, NoAnswer)
        return LastWords(str(error), error.remedy, error.code, error.final, silent)

    def leave(self, folder: Path, name: str) -> None:
        """Write them down for the supervisor.

        A disk without room for them must not replace the failure by its own: log and exit code
        tell it too.
        """
        with suppress(OSError):
            write_json(_last_words(folder, name), asdict(self))

    @staticmethod
    def find(folder: Path, name: str) -> "LastWords | None":
        """What the worker of that name wrote down; None where nothing can be read."""
        try:
            return built(LastWords, read_json(_last_words(folder, name)))
        except Misfit:  # there is no such file, or something else in it
            return None

    @staticmethod
    def forget(folder: Path, name: str) -> None:
        """Remove what an earlier process of that name wrote down."""
        _last_words(folder, name).unlink(missing_ok=True)


def _last_words(folder: Path, name: str) -> Path:
    return folder / f"{name}.last-words.json"
