"""What a launcher tells its worker processes, and how they tell it why they ended."""

import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from drcli.config import Settings
from drcli.errors import DrError, NoAnswer
from drcli.jsonrecord import Misfit, built
from drcli.rewriting import read_json, write_json

VARIABLE = "DRCLI_JOB"
"""Environment variable that carries the job to a worker process."""

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


@dataclass(frozen=True)
class Job:
    """One start of a training or an evaluation.

    Attributes:
        settings: What the racer wrote, checked.
        directory: The racer's working folder.
        session: Unique name of this start; rollouts of an earlier start never carry it.
        seed: What all random numbers of the run are derived from.
        until_laps: Finish once an evaluation completes all its laps, at least so many.
        max_minutes: Finish after so much wall time.
        folder: Where processes leave their last words on this machine.
        launcher_pid: The process whose end ends the workers too.
    """

    settings: Settings
    directory: Path
    session: str
    seed: int
    until_laps: int | None
    max_minutes: float | None
    folder: Path
    launcher_pid: int

    def to_environment(self) -> dict[str, str]:
        """The environment of a worker process of this job."""
        fields = {
            "settings": self.settings.dump(),
            "directory": str(self.directory),
            "session": self.session,
            "seed": self.seed,
            "until_laps": self.until_laps,
            "max_minutes": self.max_minutes,
            "folder": str(self.folder),
            "launcher_pid": self.launcher_pid,
        }
        return {**PROCESS_TUNING, **os.environ, VARIABLE: json.dumps(fields)}

    @staticmethod
    def from_environment() -> "Job":
        """The job that the launcher of this process gave it."""
        fields = json.loads(os.environ[VARIABLE])
        fields["settings"] = Settings.restore(fields["settings"])
        fields["directory"] = Path(fields["directory"])
        fields["folder"] = Path(fields["folder"])
        return Job(**fields)


@dataclass(frozen=True)
class LastWords:
    """Why a worker process ended.

    Attributes:
        message: One sentence.
        remedy: What to do about it.
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
