"""Topics `log:RUN:NAME`: the newest lines of a log of a run.

NAME is `supervisor`, `trainer`, `sim-0`, `reward-0` (prints of the reward function in sim-0) or
`evaluation`.
"""

import os
import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from starlette.routing import BaseRoute

from drcli.exchange.log_places import log_file
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.web.hub import Polled, Publish
from drcli.web.served_folder import ServedFolder
from drcli.web.topics import Marker, Message, Value, text_message

LOG_S = 0.7
KEPT_LINES = 300

MOST_BYTES = 1 << 16
LONGEST_LINE = 1_000
_TOPIC = re.compile(r"log:(\d{1,2}):(supervisor|trainer|evaluation|(?:sim|reward)-\d{1,3})")


@dataclass(frozen=True, eq=False)
class LogLines:
    """The newest lines of a log.

    Attributes:
        file: Another number when the log began anew.
        total: Lines that were read of it.
        note: Why there is no log.
    """

    topic: str
    file: int
    total: int
    lines: tuple[str, ...]
    note: str = ""

    def message(self, since: Marker | None) -> tuple[Message | None, Marker]:
        """`{"anew", "lines", "note"}`: lines to add, or to show instead."""
        marker = (self.file, self.total, self.note)
        if since == marker:
            return None, marker
        known = since[1] if since is not None and since[0] == self.file else None
        anew = known is None
        new = len(self.lines) if known is None else min(self.total - known, len(self.lines))
        lines = list(self.lines[len(self.lines) - new :])
        data = {"anew": anew, "lines": lines, "note": self.note}
        return text_message(self.topic, data), marker


class LogReader:
    """Of new lines."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._path: Path | None = None
        self._inode, self._offset = 0, 0
        self._file, self._total = 0, 0
        self._rest = b""
        self._lines: deque[str] = deque(maxlen=KEPT_LINES)

    def read(self, path: Path | None, missing: str) -> LogLines:
        note = ""
        try:
            if path is None:
                raise FileNotFoundError
            self._add(path)
        except FileNotFoundError:
            note = missing
            if self._total:
                self._begin(None, 0)
        except OSError as error:
            note = f"{path} cannot be read: {error.strerror}."
        return LogLines(self._topic, self._file, self._total, tuple(self._lines), note)

    def _begin(self, path: Path | None, inode: int) -> None:
        self._path, self._inode, self._offset = path, inode, 0
        self._file += 1
        self._total, self._rest = 0, b""
        self._lines.clear()

    def _add(self, path: Path) -> None:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            if (path, status.st_ino) != (self._path, self._inode) or status.st_size < self._offset:
                self._begin(path, status.st_ino)
            begin = max(self._offset, status.st_size - MOST_BYTES)
            file.seek(begin)
            data = file.read(MOST_BYTES)
            end = file.tell()
        if begin > self._offset:
            # The first line would be a part of one, and so perhaps a part of a secret.
            self._rest, data = b"", data.partition(b"\n")[2]
        self._offset = end
        *whole, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[:MOST_BYTES]
        for line in whole:
            text = line.decode("utf-8", "replace").rstrip("\r")
            self._lines.append(text[:LONGEST_LINE])
        self._total += len(whole)


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    def open_log(topic: str, publish: Publish) -> Polled:
        found = _TOPIC.fullmatch(topic)
        if found is None:
            raise ValueError(topic)
        run_id, name = int(found[1]), found[2]
        reader = LogReader(topic)

        def read() -> Value:
            record = RunRecord.read(run_folder(folder.directory, run_id))
            prefix = record.prefix if record is not None else folder.settings().model_prefix
            path = log_file(folder.directory, prefix, name)
            return reader.read(path, _missing(name))

        return Polled(topic, publish, read, LOG_S)

    folder.hub.add_kind("log", open_log)
    return []


def _missing(name: str) -> str:
    if name.startswith("reward-"):
        return "The reward function has printed nothing yet. Use print() in it to see values here."
    return f"There is no log of {name} on this machine yet. It begins when {name} starts."
