"""Turns the lines of a log into events with a time, for services that collect logs."""

import calendar
import re
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

TRACE = "SIM_TRACE_LOG:"
"""Beginning of the line of a simulation step."""

_STAMP = r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)\.(\d{3})Z"
_TIMED = re.compile(rf'{_STAMP} |\{{"time": "{_STAMP}"')


@dataclass(frozen=True)
class LogEvent:
    """A line of a log.

    Attributes:
        at_ms: Unix milliseconds. A line without a time has that of the line before, or the time
            before which it cannot have been written.
        text: The line, without its end.
    """

    at_ms: int
    text: str


class LogClock:
    """Gives each line of one log its time; never earlier than that of the line before.

    Args:
        now_ms: For lines before the first one with a time; Unix milliseconds.
    """

    def __init__(self, now_ms: int) -> None:
        self._now_ms = now_ms
        self._at_ms: int | None = None

    def pass_time(self, at_ms: int) -> None:
        """Note that no line that is still to come was written before this time."""
        self._at_ms = max(self._at_ms or 0, at_ms)

    def events(self, data: bytes, *, with_traces: bool) -> Iterator[LogEvent]:
        """The lines in some bytes of the log, without empty ones."""
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
