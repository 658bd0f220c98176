"""The record of a run on this machine."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from drcli.base.atomic_file import load_record, save_record
from drcli.base.process_identity import is_alive
from drcli.config.bucket_config import Cloud, Engine, StorageConfig

_FILE = "run.json"

_STOP_FILE = "stop-request.json"

_WAITING = "waiting-*.json"

State = Literal[
    "none", "starting", "running", "finished", "stopped", "interrupted", "failed", "lost"
]
""""interrupted": its machine went away; "lost": its supervisor left no reason."""

LIVE_STATES: tuple[State, ...] = ("starting", "running")


@dataclass(frozen=True)
class WorkerRecord:
    name: str
    pid: int | None
    restarts: int


@dataclass(frozen=True)
class StorageRecord:
    """A run's bucket, by the names of version 0.1.0.

    Attributes:
        s3_data_dir: Relative if inside the working folder, so that both can move.
    """

    cloud: Cloud
    bucket: str
    remote_minio_url: str
    profile: str
    aws_app_region: str
    local_s3_engine: Engine
    s3_data_dir: str

    @staticmethod
    def of(config: StorageConfig, directory: Path) -> "StorageRecord":
        folder = config.data_dir
        if folder.is_relative_to(directory):
            folder = folder.relative_to(directory)
        return StorageRecord(
            cloud=config.cloud,
            bucket=config.bucket,
            remote_minio_url=config.endpoint_url or "",
            profile=config.profile or "",
            aws_app_region=config.region,
            local_s3_engine=config.engine,
            s3_data_dir=str(folder),
        )

    def config(self, now: StorageConfig, directory: Path) -> StorageConfig:
        """At the start, but with the server's port and idle time of now."""
        return replace(
            now,
            cloud=self.cloud,
            bucket=self.bucket,
            data_dir=directory / self.s3_data_dir,
            engine=self.local_s3_engine,
            endpoint_url=self.remote_minio_url or None,
            profile=self.profile or None,
            region=self.aws_app_region,
        )


@dataclass(frozen=True)
class RunRecord:
    """One start of a training, in `data/runs/<DR_RUN_ID>/run.json`.

    Attributes:
        pid_started: From `process_identity.started_s`; process numbers are reused.
        storage: None in early versions.
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
    storage: StorageRecord | None = None
    priority: str = "normal"
    threads: int = 0
    ending: bool = False

    def storage_at_start(self, now: StorageConfig, directory: Path) -> StorageConfig:
        return now if self.storage is None else self.storage.config(now, directory)

    @property
    def alive(self) -> bool:
        return self.state in LIVE_STATES and is_alive(self.pid, self.pid_started)

    def write(self, folder: Path) -> None:
        save_record(folder / _FILE, self)

    @staticmethod
    def is_in(folder: Path) -> bool:
        return (folder / _FILE).exists()

    @staticmethod
    def read(folder: Path) -> "RunRecord | None":
        return load_record(RunRecord, folder / _FILE)

    def ended(
        self, state: State, exit_code: int, message: str, remedy: str, now: float
    ) -> "RunRecord":
        return replace(
            self,
            state=state,
            exit_code=exit_code,
            message=message,
            remedy=remedy,
            ended_at=now,
            ending=False,
        )


def run_folder(directory: Path, run_id: int) -> Path:
    return directory / "data" / "runs" / str(run_id)


@dataclass(frozen=True)
class StopRequest:
    """A person stops this start: its SIGTERM is not a scheduler's."""

    session: str

    def write(self, folder: Path) -> None:
        """Not on a full disk: SIGTERM is then a scheduler's."""
        with suppress(OSError):
            save_record(folder / _STOP_FILE, self)

    @staticmethod
    def is_for(session: str, folder: Path) -> bool:
        request = load_record(StopRequest, folder / _STOP_FILE)
        return request is not None and request.session == session


@dataclass(frozen=True)
class WaitingStart:
    """A process that a stop command ends although it is not a run.

    Attributes:
        kind: Waits for another start, drives for another machine, or runs a sweep.
    """

    pid: int
    pid_started: float
    bucket: str
    prefix: str
    kind: Literal["wait", "worker", "sweep"] = "wait"

    @contextmanager
    def shown(self, folder: Path) -> Iterator[None]:
        path = folder / _WAITING.replace("*", str(self.pid))
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            save_record(path, self)
        try:
            yield
        finally:
            with suppress(OSError):
                path.unlink(missing_ok=True)

    @staticmethod
    def all(folder: Path) -> "list[WaitingStart]":
        found = (load_record(WaitingStart, path) for path in sorted(folder.glob(_WAITING)))
        return [one for one in found if one is not None and is_alive(one.pid, one.pid_started)]
