"""Limits how much the racer's code prints into the log of its worker."""

import io
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import get_ident
from time import monotonic  # which the racer's code may replace in `time`
from typing import TextIO

from drcli.base.log import get_logger

BURST_CHARACTERS = 1 << 20
"""How much a reward function may print at once after it was quiet."""

CHARACTERS_S = 64 << 10
"""How much it may print a second in the long run: 100 and more characters at each step."""

TEXT_CHARACTERS = 16 << 10
"""Longest text of a reward function that is printed whole."""

reward_logger = get_logger("drcli.reward")
"""For what people must know about their reward function: it is also in the log of its prints."""

_MAIN_THREAD = threading.main_thread().ident


class PrintLimit:
    """Counts what the racer's code prints. Too much is left out, and `warn` says how much."""

    def __init__(
        self,
        warn: Callable[[str], None] = reward_logger.warning,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self.active = False
        """Whether the racer's code runs; our own output has no limit."""
        self.threads = False
        """Whether the racer's code has run, so that other threads than the main one may print for
        it at any time. Ours write with `logging` alone."""
        self._warn = warn
        self._clock = clock
        self._left = float(BURST_CHARACTERS)
        self._filled_s = clock()
        self._silent = False
        self._omitted_prints = 0
        self._omitted_characters = 0

    def applies(self) -> bool:
        """Whether it is the racer's code that prints."""
        return self.active or (self.threads and get_ident() != _MAIN_THREAD)

    def admit(self, text: str) -> str:
        """The part of a printed text that goes into the log."""
        now = self._clock()
        self._left = min(BURST_CHARACTERS, self._left + CHARACTERS_S * (now - self._filled_s))
        self._filled_s = now
        if self._silent and self._left >= BURST_CHARACTERS / 2:
            self.report()
        admitted = text
        if (more := len(text) - TEXT_CHARACTERS) > 0:
            end = "\n" if text.endswith("\n") else ""
            admitted = f"{text[:TEXT_CHARACTERS]} ... ({more:,} more characters are left out){end}"
        if not self._silent and len(admitted) > self._left:
            self._silent = True
            self._warn(
                "The reward function prints too much. Its output is left out for some seconds."
            )
        if self._silent:
            self._omitted_prints += text != "\n"  # print() writes the end of its line separately
            self._omitted_characters += len(text)
            return ""
        self._left -= len(admitted)
        return admitted

    def report(self) -> None:
        """Log how much was left out since the last report."""
        if self._silent:
            self._warn(
                f"{self._omitted_prints:,} prints of the reward function "
                f"({self._omitted_characters / 1e6:,.1f} MB) were left out. "
                f"The limit is {CHARACTERS_S >> 10} KB a second."
            )
        self._silent, self._omitted_prints, self._omitted_characters = False, 0, 0


class LimitedStream(io.TextIOWrapper):
    """Standard output or error with a limit. It writes line by line.

    Args:
        inner: The stream that it replaces.
        limit: Of what the racer's code prints.
        copies: Take what the racer's code prints within the limit, too.
    """

    def __init__(
        self, inner: TextIO, limit: PrintLimit, copies: Sequence[Callable[[str], None]] = ()
    ) -> None:
        super().__init__(inner.buffer, inner.encoding, inner.errors, line_buffering=True)
        self._limit = limit
        self._copies = copies

    def write(self, text: str, /) -> int:
        """Write a text, or the part that the limit admits."""
        if not self._limit.applies():
            super().write(text)
            return len(text)
        admitted = self._limit.admit(text)
        super().write(admitted)
        if admitted:
            for copy in self._copies:
                copy(admitted)
        return len(text)


_limit = PrintLimit()


def install(copies: Sequence[Callable[[str], None]] = ()) -> None:
    """Take over this process's standard output and error.

    Each of the `copies` gets what the racer's code prints, as far as the limit admits it.
    """
    sys.stdout = LimitedStream(sys.stdout, _limit, copies)
    sys.stderr = LimitedStream(sys.stderr, _limit, copies)


@contextmanager
def limited_prints() -> Iterator[None]:
    """Limit what is printed inside, where the racer's code runs."""
    _limit.active = _limit.threads = True
    try:
        yield
    finally:
        _limit.active = False


def end_limit() -> None:
    """Lift the limit and log what was left out, even if the racer's code never returned."""
    _limit.active = _limit.threads = False
    _limit.report()
