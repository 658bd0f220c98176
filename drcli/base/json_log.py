"""The log of a process as JSON lines.

`time` (UTC, ISO 8601), `level`, `process` and `message`; for events also `event` and facts. Lines
of every step are only in the trace.
"""

import json
import logging
import math
import threading
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drcli.base.log import add_handler, remove_handler, traces
from drcli.base.rotating_file import LONGEST_LINE, RotatingFile

PRINT = "print"
_OWN = ("time", "level", "process", "event", "message")


class JsonLog(logging.Handler):
    """With older parts it has `max_bytes`."""

    def __init__(self, path: Path, max_bytes: int, process: str) -> None:
        super().__init__()
        self._file = RotatingFile(path, max_bytes)
        self._process = process
        self._printed = ""
        self._printing = threading.Lock()
        add_handler(self)

    def emit(self, record: logging.LogRecord) -> None:
        if record.name == traces.name:
            return
        try:
            message = record.getMessage()
            if record.exc_info:
                message += "\n" + "".join(traceback.format_exception(*record.exc_info)).rstrip()
            facts = getattr(record, "facts", {})
            self._write(
                record.created, record.levelname, getattr(record, "event", ""), message, facts
            )
        except Exception:  # as in every handler: a record that cannot be written ends nothing
            self.handleError(record)

    def printed(self, text: str) -> None:
        with self._printing:
            *lines, rest = (self._printed + text).split("\n")
            if len(rest) > LONGEST_LINE:
                lines, rest = [*lines, rest], ""
            self._printed = rest
        for line in lines:
            self._write(time.time(), "INFO", PRINT, line, {})

    def end(self) -> None:
        remove_handler(self)
        if self._printed:
            self.printed("\n")
        self._file.close()

    def _write(
        self, created_s: float, level: str, event: str, message: str, facts: Mapping[str, Any]
    ) -> None:
        if not message.strip():
            return
        record: dict[str, Any] = {"time": utc(created_s), "level": level, "process": self._process}
        if event:
            record["event"] = event
        record["message"] = message.strip("\n")
        record |= {name: _known(value) for name, value in facts.items() if name not in _OWN}
        self._file.write(json.dumps(record, allow_nan=False, default=str) + "\n")


def utc(at_s: float) -> str:
    """2026-11-22T09:30:00.123Z."""
    milliseconds = int(at_s * 1000)
    moment = time.gmtime(milliseconds // 1000)
    return f"{time.strftime('%Y-%m-%dT%H:%M:%S', moment)}.{milliseconds % 1000:03d}Z"


def _known(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {str(name): _known(item) for name, item in value.items()}
    return [_known(item) for item in value] if isinstance(value, list | tuple) else value
