"""Limits how much the racer's code prints into the log of its worker."""

import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from time import monotonic

from drcli.base.log import get_logger

BURST_CHARACTERS = 1 << 20
"""At once after it was quiet."""

CHARACTERS_S = 64 << 10
"""In the long run: 100 and more characters at each step."""

TEXT_CHARACTERS = 16 << 10
reward_logger = get_logger("drcli.reward")
"""Also in the log of its prints."""


class PrintLimit:
    """Too much is left out, and `warn` says how much.

    `copies` also get what `write` prints.
    """

    def __init__(
        self,
        warn: Callable[[str], None] = reward_logger.warning,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self.copies: Sequence[Callable[[str], None]] = ()
        self._warn = warn
        self._clock = clock
        self._left = float(BURST_CHARACTERS)
        self._filled_s = clock()
        self._silent = False
        self._omitted_prints = 0
        self._omitted_characters = 0

    def admit(self, text: str) -> str:
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
        if self._silent:
            self._warn(
                f"{self._omitted_prints:,} prints of the reward function "
                f"({self._omitted_characters / 1e6:,.1f} MB) were left out. "
                f"The limit is {CHARACTERS_S >> 10} KB a second."
            )
        self._silent, self._omitted_prints, self._omitted_characters = False, 0, 0

    def write(self, text: str) -> None:
        admitted = self.admit(text)
        if not admitted:
            return
        with suppress(OSError):  # a full disk; a print must neither fail nor wait
            sys.stdout.write(admitted)
            sys.stdout.flush()
        for copy in self.copies:
            copy(admitted)


theirs = PrintLimit()
"""Of this process."""
