"""The pulse of a worker: a small file on this machine that says how far the worker is.

A thread of the worker writes it every two seconds, always over the same bytes of the same file: it
needs no new room on a full disk. A reader may see half of a new pulse; its checksum then fails, and
the reader keeps the pulse before.
"""

import os
import zlib
from dataclasses import dataclass
from pathlib import Path

from drcli.base.json_record import JsonRecord, RecordError

FILE_BYTES = 1024
"""Size of the file: the record, filled up with blanks."""

_SUM_BYTES = 9
_ACTIVITY_CHARACTERS = 120


@dataclass(frozen=True)
class PulseRecord(JsonRecord):
    """How far a worker is. All times are `elapsed_s` of this machine.

    Attributes:
        pid: Its process.
        beats: How often this process has written its pulse.
        written_s: When it was written.
        activity: What the worker does or waits for, in a few words.
        waits: Whether it waits for another worker.
        work: Finished steps of driving (all cars at once) or of learning since its start.
        worked_s: When the last of them was finished; None before the first.
        turned_s: When the main thread last came by. It does not while it is inside one long call.
        memory_bytes: Memory of the process (resident set).
        open_files: Number of its open files; 0 if unknown.
    """

    pid: int
    beats: int
    written_s: float
    activity: str
    waits: bool
    work: int
    worked_s: float | None
    turned_s: float
    memory_bytes: int = 0
    open_files: int = 0

    def file_content(self) -> bytes:
        """The whole content of the file."""
        data = self.encode()
        data = b"%08x %s" % (zlib.crc32(data), data)
        if len(data) > FILE_BYTES:
            raise ValueError(f"a pulse has {len(data)} bytes, its file only {FILE_BYTES}")
        return data.ljust(FILE_BYTES)

    @staticmethod
    def read(folder: Path, name: str) -> "PulseRecord | None":
        """The last pulse of a worker; None if there is none, or while it is being written."""
        try:
            content = pulse_file(folder, name).read_bytes().rstrip()
            told, data = content[: _SUM_BYTES - 1], content[_SUM_BYTES:]
            if told != b"%08x" % zlib.crc32(data):
                return None
            return PulseRecord.decode(data)
        except (OSError, RecordError):
            return None


def pulse_file(folder: Path, name: str) -> Path:
    """The file of a worker's pulse in the folder of its run."""
    return folder / f"{name}.pulse"


def short_activity(text: str) -> str:
    """An activity that fits into the file; it is plain ASCII, because JSON may escape the rest."""
    ascii_text = text.encode("ascii", "replace").decode()
    return ascii_text[:_ACTIVITY_CHARACTERS]


def open_pulse_file(folder: Path, name: str) -> int:
    """A descriptor of an empty pulse file; that of an earlier process is replaced.

    Raises:
        OSError: It cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = pulse_file(folder, name)
    path.unlink(missing_ok=True)  # an earlier process may still have it open
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
