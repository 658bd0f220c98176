"""What a worker process prints: into a log that is rotated, the racer's own prints within bounds.

The log is the process's standard output and error at the level of the system, so that faults of C
code reach it too. To rotate it, the process puts a new file in its place between two lines: nothing
is lost, no other process is needed for it, and one that is killed leaves whole files behind.
"""

import io
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic, sleep  # which the racer's code may replace in `time`
from typing import Any, TextIO

from drcli.base import log_files

LOOK_S = 0.1
"""How often the size of the log is checked."""

PATIENCE_LOOKS = 4
"""After so many checks a log is rotated in the middle of a line, which may never end."""

BURST_CHARACTERS = 1 << 20
"""How much a reward function may print at once after it was quiet."""

CHARACTERS_S = 64 << 10
"""How much it may print a second in the long run: 100 and more characters at each step."""

TEXT_CHARACTERS = 16 << 10
"""Longest text of a reward function that is printed whole."""


class PrintLimit:
    """How much the racer's code may still print; what is more is left out, and that is said.

    Args:
        clock: Monotonic seconds, for tests.
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._left = float(BURST_CHARACTERS)
        self._filled_s = clock()
        self._silent = False
        self._omitted_prints = 0
        self._omitted_characters = 0
        self._ended_line = True

    def admit(self, text: str) -> str:
        """What of a printed text goes into the log, with a line about what did not."""
        now = self._clock()
        self._left = min(BURST_CHARACTERS, self._left + CHARACTERS_S * (now - self._filled_s))
        self._filled_s = now
        note = ""
        if self._silent:
            if self._left < BURST_CHARACTERS / 2:
                self._omit(text)
                return ""
            note = self.summary()
        admitted = text if len(text) <= TEXT_CHARACTERS else _shortened(text)
        if len(admitted) > self._left:
            self._silent = True
            self._omit(text)
            start = "" if self._ended_line else "\n"
            self._ended_line = True
            return (
                f"{note}{start}Prints> The reward function prints too much. Its prints are left "
                "out for some seconds.\n"
            )
        self._left -= len(admitted)
        self._ended_line = admitted.endswith("\n")
        return note + admitted

    def summary(self) -> str:
        """A line about what was left out since the last one; empty where nothing was."""
        if not self._silent:
            return ""
        prints, characters = self._omitted_prints, self._omitted_characters
        self._silent, self._omitted_prints, self._omitted_characters = False, 0, 0
        return (
            f"Prints> {prints:,} prints of the reward function with {characters / 1e6:,.1f} MB "
            f"were left out. The limit is {CHARACTERS_S >> 10} KB a second.\n"
        )

    def _omit(self, text: str) -> None:
        self._omitted_prints += text != "\n"  # print() writes the end of its line for itself
        self._omitted_characters += len(text)


class Output:
    """Standard output and error of a worker process.

    Args:
        limit: For what the racer's code prints.
    """

    def __init__(self, limit: PrintLimit) -> None:
        self.limited = False
        self._limit = limit
        self._inner: list[TextIO] = []
        # One thread may come back to it: an alarm may interrupt the racer's code in a print.
        self._lock = threading.RLock()
        # A reward function may fork while the log is being rotated: its child would wait for ever.
        os.register_at_fork(after_in_child=self._unlock)
        self._ended_line = True
        self._waited = 0

    def _unlock(self) -> None:
        self._lock = threading.RLock()

    def stream(self, inner: TextIO) -> TextIO:
        """A stream whose prints are counted while the racer's code runs."""
        self._inner.append(inner)
        # Not one of io's classes, because it passes everything but `write` on to another stream.
        return _Stream(self, inner)  # type: ignore[return-value]

    def write(self, inner: TextIO, text: str) -> None:
        """Print a text, or what is admitted of it."""
        with self._lock:
            admitted = self._limit.admit(text) if self.limited else text
            if admitted:
                inner.write(admitted)
                self._ended_line = admitted.endswith("\n")

    def end_limit(self) -> None:
        """Print all that follows, after a line about what was left out until now."""
        with self._lock:
            self.limited = False
            summary = self._limit.summary()
            if summary:
                self.write(self._inner[0], summary)

    def rotate_if_large(self, log: Path, max_bytes: int) -> bool:
        """Begin a new file where the log is too large, if this process writes into it.

        Returns:
            Whether there is a new file.
        """
        with self._lock:
            state = os.fstat(1)
            if state.st_size < log_files.part_bytes(max_bytes) or not _is(log, state):
                return False
            if not self._ended_line and self._waited < PATIENCE_LOOKS:
                self._waited += 1
                return False
            self._waited = 0
            for inner in self._inner:
                inner.flush()
            fresh = log_files.rotate(log, max_bytes)
            try:
                os.dup2(fresh, 1)
                os.dup2(fresh, 2)
            finally:
                os.close(fresh)
        return True


class _Stream:
    """A text stream that passes on everything but what is too much."""

    def __init__(self, output: Output, inner: TextIO) -> None:
        self._output = output
        self._inner = inner

    def write(self, text: str) -> int:
        self._output.write(self._inner, text)
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # a copy asks for these before it has them itself
            raise AttributeError(name)
        return getattr(self._inner, name)


_output = Output(PrintLimit())


def install(max_bytes: int) -> None:
    """Take over this process's standard output and error.

    Args:
        max_bytes: How large its log may become, older parts included.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(line_buffering=True)
    sys.stdout = _output.stream(sys.stdout)
    sys.stderr = _output.stream(sys.stderr)
    log = os.environ.get(log_files.VARIABLE)
    if log:
        threading.Thread(target=_keep_small, args=(Path(log), max_bytes), daemon=True).start()


@contextmanager
def limited_prints() -> Iterator[None]:
    """Limit what is printed inside: the racer's code runs there."""
    _output.limited = True
    try:
        yield
    finally:
        _output.limited = False


def end_limit() -> None:
    """Print all that follows, also where the racer's code was interrupted and never returned."""
    _output.end_limit()


def _keep_small(log: Path, max_bytes: int) -> None:
    while True:
        sleep(LOOK_S)
        with suppress(OSError):  # a full disk, or a folder that is gone: the next look may do
            _output.rotate_if_large(log, max_bytes)


def _is(path: Path, state: os.stat_result) -> bool:
    """Whether a path leads to an open file."""
    try:
        return os.path.samestat(path.stat(), state)
    except FileNotFoundError:
        return False


def _shortened(text: str) -> str:
    end = "\n" if text.endswith("\n") else ""
    more = len(text) - TEXT_CHARACTERS
    return f"{text[:TEXT_CHARACTERS]} ... ({more:,} more characters are left out){end}"
