"""What a supervisor's watches warn of, for `dr-status`."""

from dataclasses import dataclass, field
from pathlib import Path

from drcli.base.atomic_file import load_record, save_record

_FILE = "watches.json"


@dataclass(frozen=True)
class WatchRecord:
    session: str
    warnings: list[str] = field(default_factory=list)

    def write(self, folder: Path) -> None:
        save_record(folder / _FILE, self)

    @staticmethod
    def read(folder: Path, session: str) -> "WatchRecord":
        found = load_record(WatchRecord, folder / _FILE)
        return found if found is not None and found.session == session else WatchRecord(session)
