"""The record of a run on this machine."""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from drcli.base.files import FileRecord, find_files, load_record, save_record
from drcli.base.json_record import JsonRecord, Pid, SafeInt, Seconds
from drcli.base.processes import is_alive
from drcli.config.run_config import Cloud, Engine, StorageConfig

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
    pid: Pid | None
    restarts: SafeInt


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
class RunRecord(FileRecord):
    """One start of a training, in `data/runs/<DR_RUN_ID>/run.json`.

    Attributes:
        pid_started: From `process_identity.started_s`; process numbers are reused.
        storage: None in early versions.
    """

    FILE = "run.json"

    run_id: SafeInt
    session: str
    bucket: str
    prefix: str
    world: str
    state: State
    pid: Pid
    pid_started: Seconds
    started_at: Seconds
    ended_at: Seconds | None = None
    exit_code: SafeInt | None = None
    message: str = ""
    remedy: str = ""
    workers: list[WorkerRecord] = field(default_factory=list)
    storage: StorageRecord | None = None
    priority: str = "normal"
    threads: SafeInt = 0
    ending: bool = False

    def storage_at_start(self, now: StorageConfig, directory: Path) -> StorageConfig:
        return now if self.storage is None else self.storage.config(now, directory)

    @property
    def alive(self) -> bool:
        return self.state in LIVE_STATES and is_alive(self.pid, self.pid_started)

    @staticmethod
    def is_in(folder: Path) -> bool:
        return (folder / RunRecord.FILE).exists()

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

    pid: Pid
    pid_started: Seconds
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


# Records in the bucket while a training runs.


@dataclass(frozen=True)
class ActivityRecord(JsonRecord):
    activity: str
    since: Seconds
    pid: Pid
    host: str


@dataclass(frozen=True)
class TrainingEnd(JsonRecord):
    session: str
    reason: str


@dataclass(frozen=True)
class Lease(JsonRecord):
    """Who trains on a prefix.

    Attributes:
        pid: Its supervisor.
        renewed: Unix seconds by its machine's clock.
        machine: Unique for machine and container.
        term: Counts owners. The higher term is right: a suspended owner may write once more.
        trainer: Number of the trainer process that may write; an earlier one may live elsewhere.
        released: The owner has ended. The record stays, so that a suspended owner learns of it.
        newer: A newer drcli wrote it, so nothing else is known; like `age_s`, not in the file.
    """

    session: str
    host: str
    pid: Pid
    renewed: Seconds
    machine: str = ""
    pid_started: Seconds = 0.0
    term: SafeInt = 0
    trainer: SafeInt = 0
    released: bool = False
    age_s: Seconds = 0.0
    newer: bool = False

    @staticmethod
    def of_newer() -> "Lease":
        return Lease(session="of a newer drcli", host="a newer drcli", pid=0, renewed=0, newer=True)

    def to_json(self) -> dict[str, Any]:
        fields = super().to_json()
        del fields["age_s"], fields["newer"]
        return fields

    @property
    def owner(self) -> str:
        return "a newer version of drcli" if self.newer else f"process {self.pid} on {self.host}"

    def outranks(self, session: str, term: int) -> bool:
        """Whether the owner of this term has lost the prefix."""
        if self.newer:
            return True
        return self.session != session and self.term >= term


# Where the logs of a run are, here and in the bucket.


KINDS = ("robomaker", "sagemaker", "reward")
"""Folders. log-guru fails on other logs among simulation logs."""

REWARD = "reward-"


def log_kind(name: str) -> str:
    simulation, others, reward = KINDS
    if name.startswith(REWARD):
        return reward
    return simulation if name.startswith(("sim", "joined")) else others


def log_folder(directory: Path, prefix: str, kind: str) -> Path:
    return directory / "data" / "logs" / kind / prefix


def log_file(directory: Path, prefix: str, name: str) -> Path:
    """For "trainer", "supervisor", "sim-0", ..."""
    return log_folder(directory, prefix, log_kind(name)) / f"{name}.log"


def json_log(log: Path) -> Path:
    return log.with_suffix(".jsonl")


def reward_log(worker: str) -> str:
    """The racer's prints: `reward-0` for `sim-0`."""
    return REWARD + worker.removeprefix("sim-")


# Records of running evaluations, so that another shell can stop them.


@dataclass(frozen=True)
class EvaluationRecord(FileRecord):
    """A running evaluation, in `data/runs/<DR_RUN_ID>/evaluations/<stamp>/`.

    Attributes:
        pid: Waits for the end; stop this one to stop the evaluation.
        pid_started: From `process_identity.started_s`; process numbers are reused.
        worker_pid: Drives.
    """

    FILE = "running.json"

    run_id: SafeInt
    stamp: str
    bucket: str
    prefix: str
    world: str
    checkpoint: str
    pid: Pid
    pid_started: Seconds
    worker_pid: Pid
    started_at: Seconds
    others: list[str] = field(default_factory=list)

    @property
    def alive(self) -> bool:
        return is_alive(self.pid, self.pid_started)


def claim(directory: Path, run_id: int, stamp: str) -> Path | None:
    """Create the folder; None if the name is taken."""
    folder = run_folder(directory, run_id) / "evaluations" / stamp
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        folder.mkdir()
    except FileExistsError:
        return None
    return folder


def running_evaluations(directory: Path, run_id: int | None = None) -> list[EvaluationRecord]:
    folders = find_files(directory, f"data/runs/{'*' if run_id is None else run_id}/evaluations/*")
    records = (EvaluationRecord.read(folder) for folder in folders)
    return sorted(
        (record for record in records if record is not None and record.alive),
        key=lambda record: record.started_at,
    )


def sweep(directory: Path, run_id: int) -> None:
    for folder in run_folder(directory, run_id).glob("evaluations/*"):
        record = EvaluationRecord.read(folder)
        if record is not None and not record.alive:
            shutil.rmtree(folder, ignore_errors=True)


# An event in the journal of a run.


Kind = Literal["start", "notice", "fault", "recovery", "stage", "upload", "message", "end"]
"""`fault`: something broke; `recovery`: was put right."""


@dataclass(frozen=True)
class JournalEntry(JsonRecord):
    """`at` is Unix seconds, `text` for people, `facts` for programs."""

    at: float
    kind: Kind
    text: str
    facts: Mapping[str, Any] = field(default_factory=dict)

    def encode_line(self) -> bytes:
        return self.encode() + b"\n"
