"""What the trainer says when a stage or a phase begins, for the supervisor on the same machine."""

from dataclasses import dataclass
from pathlib import Path

from drcli.base.atomic_file import load_record, save_record

_FILE = "stage.json"


@dataclass(frozen=True)
class StageNote:
    """The newest stage, or phase of a training with a teacher, that began in a start.

    Attributes:
        session: Of the start.
        stage: Name of the stage or phase.
        checkpoint: Its first checkpoint.
        text: Sentences for people.
    """

    session: str
    stage: str
    checkpoint: str
    text: str

    def write(self, folder: Path) -> None:
        """Write it into the folder of the run; raises OSError."""
        save_record(folder / _FILE, self)

    @staticmethod
    def read(folder: Path, session: str) -> "StageNote | None":
        """That of a start; None if there is none."""
        found = load_record(StageNote, folder / _FILE)
        return found if found is not None and found.session == session else None
