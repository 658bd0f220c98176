"""The note a run leaves on this machine: who supervises it and how it is going."""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal

from drcli.base.atomic_file import read_json, write_json
from drcli.base.json_record import Misfit, built
from drcli.base.process_identity import is_alive
from drcli.config.settings import Settings

_FILE = "run.json"

State = Literal["none", "starting", "running", "finished", "stopped", "failed", "lost"]
"""Where a run is in its life. "lost": its supervisor ended without saying why."""

_STORAGE = (
    *("cloud", "bucket", "remote_minio_url", "profile", "aws_app_region"),
    *("local_s3_engine", "s3_data_dir"),
)

LIVE_STATES: tuple[State, ...] = ("starting", "running")


@dataclass(frozen=True)
class WorkerRecord:
    """A worker process as its supervisor knows it."""

    name: str
    pid: int | None
    restarts: int


@dataclass(frozen=True)
class RunRecord:
    """One start of a training, kept in `data/runs/<DR_RUN_ID>/run.json`.

    Attributes:
        run_id: DR_RUN_ID.
        session: Unique name of the start.
        bucket: Name of the bucket.
        prefix: Model prefix.
        world: DR_WORLD_NAME.
        state: As the supervisor last wrote it.
        pid: The supervisor.
        pid_started: When that process began, as `process_identity.started_s` gives it: process
            numbers are used again.
        started_at: Unix seconds.
        ended_at: Unix seconds, or None.
        exit_code: Of the supervisor, when it has ended.
        message: Why the run ended.
        remedy: What to do about it.
        workers: Its processes.
        storage: Settings that led to its bucket, by the name of their field.
    """

    run_id: int
    session: str
    bucket: str
    prefix: str
    world: str
    state: State
    pid: int
    pid_started: float
    started_at: float
    ended_at: float | None = None
    exit_code: int | None = None
    message: str = ""
    remedy: str = ""
    workers: list[WorkerRecord] = field(default_factory=list)
    storage: dict[str, str] = field(default_factory=dict)

    def settings(self, now: Settings) -> Settings:
        """The settings of now, with those that the model and its bucket had at the start."""
        return now.replaced(**self.storage, model_prefix=self.prefix)

    @property
    def alive(self) -> bool:
        """Whether the supervisor still runs."""
        return self.state in LIVE_STATES and is_alive(self.pid, self.pid_started)

    def write(self, folder: Path) -> None:
        """Replace the note in one step, so that a reader never sees half of it."""
        write_json(folder / _FILE, asdict(self))

    @staticmethod
    def read(folder: Path) -> "RunRecord | None":
        """The note of the last start; None if nothing was started yet, or it is damaged."""
        try:
            return built(RunRecord, read_json(folder / _FILE))
        except Misfit:
            return None

    def ended(
        self, state: State, exit_code: int, message: str, remedy: str, now: float
    ) -> "RunRecord":
        """The note once the run is over."""
        return replace(
            self,
            state=state,
            exit_code=exit_code,
            message=message,
            remedy=remedy,
            ended_at=now,
        )


def storage_of(settings: Settings) -> dict[str, str]:
    """What leads to the bucket of some settings."""
    return {name: str(getattr(settings, name)) for name in _STORAGE}


def run_folder(settings: Settings, directory: Path) -> Path:
    """Where this machine keeps what it knows of the run."""
    return directory / "data" / "runs" / str(settings.run_id)
