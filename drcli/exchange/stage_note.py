"""What the trainer tells its supervisor when a stage or phase begins."""

from dataclasses import dataclass
from pathlib import Path

from drcli.base.atomic_file import load_record, save_record

_FILE = "stage.json"


@dataclass(frozen=True)
class StageNote:
    session: str
    stage: str
    checkpoint: str
    text: str

    def write(self, folder: Path) -> None:
        save_record(folder / _FILE, self)

    @staticmethod
    def read(folder: Path, session: str) -> "StageNote | None":
        found = load_record(StageNote, folder / _FILE)
        return found if found is not None and found.session == session else None
