"""Turns lines of a log into events with a time."""

import calendar
import re
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

TRACE = "SIM_TRACE_LOG:"
_STAMP = r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)\.(\d{3})Z"
_TIMED = re.compile(rf'{_STAMP} |\{{"time": "{_STAMP}"')


@dataclass(frozen=True)
class LogEvent:
    """A line without a time has that of the line before."""

    at_ms: int
    text: str


class LogClock:
    """Gives lines times that never go back; `now_ms` until the first time."""

    def __init__(self, now_ms: int) -> None:
        self._now_ms = now_ms
        self._at_ms: int | None = None

    def pass_time(self, at_ms: int) -> None:
        """No later line was written before this time."""
        self._at_ms = max(self._at_ms or 0, at_ms)

    def events(self, data: bytes, *, with_traces: bool) -> Iterator[LogEvent]:
        for line in data.decode("utf-8", "replace").split("\n"):
            text = line.rstrip("\r")
            if not text.strip() or (text.startswith(TRACE) and not with_traces):
                continue
            found = _TIMED.match(text)
            if found is not None:
                with suppress(ValueError):  # such as the 99th month
                    self.pass_time(_milliseconds(found[1] or found[3], found[2] or found[4]))
            yield LogEvent(self._now_ms if self._at_ms is None else self._at_ms, text)


def _milliseconds(moment: str, milliseconds: str) -> int:
    parsed = time.strptime(moment, "%Y-%m-%dT%H:%M:%S")
    return calendar.timegm(parsed) * 1000 + int(milliseconds)
