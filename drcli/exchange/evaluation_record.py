"""Records of running evaluations on this machine, so that another shell can stop them."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path

from drcli.base.atomic_file import load_record, save_record
from drcli.base.process_identity import is_alive
from drcli.exchange.run_record import run_folder

_FILE = "running.json"


@dataclass(frozen=True)
class EvaluationRecord:
    """One evaluation while it runs, in `data/runs/<DR_RUN_ID>/evaluations/<stamp>/`.

    Attributes:
        stamp: The name of the evaluation, fourteen digits.
        pid: The process that waits for its end; to stop the evaluation, stop this one.
        pid_started: From `process_identity.started_s`, because process numbers are reused.
        worker_pid: The process that drives.
        others: Prefixes of all further models that drive: an opponent, or those of a table.
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
        """Whether it still runs."""
        return is_alive(self.pid, self.pid_started)

    def write(self, folder: Path) -> None:
        """Write the record in one step."""
        save_record(folder / _FILE, self)

    @staticmethod
    def read(folder: Path) -> "EvaluationRecord | None":
        """The record in the folder of an evaluation; None if there is none or it is damaged."""
        return load_record(EvaluationRecord, folder / _FILE)


def claim(directory: Path, run_id: int, stamp: str) -> Path | None:
    """Create the folder of an evaluation; None if another one has this name already."""
    folder = run_folder(directory, run_id) / "evaluations" / stamp
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        folder.mkdir()
    except FileExistsError:
        return None
    return folder


def running_evaluations(directory: Path, run_id: int | None = None) -> list[EvaluationRecord]:
    """Evaluations that run in a working folder, oldest first."""
    folders = directory.glob(f"data/runs/{'*' if run_id is None else run_id}/evaluations/*")
    records = (EvaluationRecord.read(folder) for folder in folders)
    return sorted(
        (record for record in records if record is not None and record.alive),
        key=lambda record: record.started_at,
    )


def sweep(directory: Path, run_id: int) -> None:
    """Remove the folders of evaluations that were killed."""
    for folder in run_folder(directory, run_id).glob("evaluations/*"):
        record = EvaluationRecord.read(folder)
        if record is not None and not record.alive:
            shutil.rmtree(folder, ignore_errors=True)
