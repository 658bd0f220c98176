"""Records of running evaluations, so that another shell can stop them."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path

from drcli.base.atomic_file import load_record, save_record
from drcli.base.process_identity import is_alive
from drcli.exchange.run_record import run_folder

_FILE = "running.json"


@dataclass(frozen=True)
class EvaluationRecord:
    """A running evaluation, in `data/runs/<DR_RUN_ID>/evaluations/<stamp>/`.

    Attributes:
        pid: Waits for the end; stop this one to stop the evaluation.
        pid_started: From `process_identity.started_s`; process numbers are reused.
        worker_pid: Drives.
    """

    run_id: int
    stamp: str
    bucket: str
    prefix: str
    world: str
    checkpoint: str
    pid: int
    pid_started: float
    worker_pid: int
    started_at: float
    others: list[str] = field(default_factory=list)

    @property
    def alive(self) -> bool:
        return is_alive(self.pid, self.pid_started)

    def write(self, folder: Path) -> None:
        save_record(folder / _FILE, self)

    @staticmethod
    def read(folder: Path) -> "EvaluationRecord | None":
        return load_record(EvaluationRecord, folder / _FILE)


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
    folders = directory.glob(f"data/runs/{'*' if run_id is None else run_id}/evaluations/*")
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
