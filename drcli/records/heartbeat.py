"""The heartbeat of a worker: a small file on this machine that says how far it is.

A thread writes it every two seconds over the same bytes, which works on a full disk. A checksum
shows a half-written one; the reader keeps the one before.
"""

import os
import zlib
from dataclasses import dataclass, field
from pathlib import Path

from drcli.base.files import FileRecord
from drcli.base.json_record import JsonRecord, Pid, RecordError, SafeInt, Seconds

FILE_BYTES = 1024
_SUM_BYTES = 9
_ACTIVITY_CHARACTERS = 120


@dataclass(frozen=True)
class HeartbeatRecord(JsonRecord):
    """How far a worker is. All times are `elapsed_s` of this machine.

    Attributes:
        waits: For another worker.
        work: Steps of driving (all cars at once) or learning.
        turned_s: When the main thread last came by; not inside one long call.
        memory_bytes: Resident set.
        cores: Kept busy on average, in the last seconds.
    """

    pid: Pid
    beats: SafeInt
    written_s: Seconds
    activity: str
    waits: bool
    work: SafeInt
    worked_s: Seconds | None
    turned_s: Seconds
    memory_bytes: SafeInt = 0
    open_files: SafeInt = 0
    cores: Seconds = 0.0

    def file_content(self) -> bytes:
        data = self.encode()
        data = b"%08x %s" % (zlib.crc32(data), data)
        if len(data) > FILE_BYTES:
            raise ValueError(f"a heartbeat has {len(data)} bytes, its file only {FILE_BYTES}")
        return data.ljust(FILE_BYTES)

    @staticmethod
    def read(folder: Path, name: str) -> "HeartbeatRecord | None":
        """None if missing or being written."""
        try:
            content = heartbeat_file(folder, name).read_bytes().rstrip()
            told, data = content[: _SUM_BYTES - 1], content[_SUM_BYTES:]
            if told != b"%08x" % zlib.crc32(data):
                return None
            return HeartbeatRecord.decode(data)
        except (OSError, RecordError):
            return None


def heartbeat_file(folder: Path, name: str) -> Path:
    return folder / f"{name}.heartbeat"


def short_activity(text: str) -> str:
    """Fits into the file; ASCII, because JSON may escape the rest."""
    ascii_text = text.encode("ascii", "replace").decode()
    return ascii_text[:_ACTIVITY_CHARACTERS]


def open_heartbeat_file(folder: Path, name: str) -> int:
    """A descriptor of a new file; raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    path = heartbeat_file(folder, name)
    path.unlink(missing_ok=True)  # an earlier process may still have it open
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)


# What a supervisor's watches warn of, for `dr-status`.


@dataclass(frozen=True)
class WatchRecord(FileRecord):
    FILE = "watches.json"

    session: str
    warnings: list[str] = field(default_factory=list)

    @staticmethod
    def of_session(folder: Path, session: str) -> "WatchRecord":
        found = WatchRecord.read(folder)
        return found if found is not None and found.session == session else WatchRecord(session)
