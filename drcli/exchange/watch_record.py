"""What the watches of a supervisor warn of, for `dr-status` on the same machine."""

from dataclasses import dataclass, field
from pathlib import Path

from drcli.base.atomic_file import load_record, save_record

_FILE = "watches.json"


@dataclass(frozen=True)
class WatchRecord:
    """The warnings of one start of a training.

    Attributes:
        session: Of the start.
        warnings: A sentence each.
    """

    session: str
    warnings: list[str] = field(default_factory=list)

    def write(self, folder: Path) -> None:
        """Replace the record in the folder of a run.

        Raises:
            OSError: It cannot be written.
        """
        save_record(folder / _FILE, self)

    @staticmethod
    def read(folder: Path, session: str) -> "WatchRecord":
        """The record of a start; an empty one if there is none."""
        found = load_record(WatchRecord, folder / _FILE)
        return found if found is not None and found.session == session else WatchRecord(session)
