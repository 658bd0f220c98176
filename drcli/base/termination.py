"""Lets SIGTERM end a piece of work with cleanup, as Ctrl-C does."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import ClassVar

from drcli.base.errors import DrError

_NOTED = (signal.SIGINT, signal.SIGTERM)


class Stopped(DrError):
    """SIGTERM stopped the work."""

    code: ClassVar[int] = 143
    final: ClassVar[bool] = True


class _Terminated(BaseException):
    """SIGTERM came. Not an Exception, so that `except Exception` does not catch it."""


class NotedSignals:
    """Notes Ctrl-C and SIGTERM while its `with` block runs, for work that ends at its own pace.

    Only in the main thread.

    Attributes:
        first: The first signal; None before one.
        count: How many have come.
    """

    def __init__(self) -> None:
        self.first: signal.Signals | None = None
        self.count = 0

    def __enter__(self) -> "NotedSignals":
        """Note signals from now on."""
        self._before = [signal.signal(each, self._note) for each in _NOTED]
        return self

    def __exit__(self, *_error: object) -> None:
        """Let signals do what they did before."""
        for each, before in zip(_NOTED, self._before, strict=True):
            signal.signal(each, before)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.first = self.first or signal.Signals(number)
        self.count += 1

    def refuse(self, message: str, remedy: str) -> None:
        """Return if no signal has come.

        Raises:
            KeyboardInterrupt: Ctrl-C has.
            Stopped: SIGTERM has. It has this message and remedy.
        """
        if self.first == signal.SIGINT:
            raise KeyboardInterrupt
        if self.first is not None:
            raise Stopped(message, remedy=remedy)


@contextmanager
def until_sigterm(message: str, remedy: str) -> Iterator[None]:
    """Let SIGTERM end the `with` block; only in the main thread.

    Raises:
        Stopped: SIGTERM came. It has this message and remedy.
    """

    def stop(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise _Terminated

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    except _Terminated:
        raise Stopped(message, remedy=remedy) from None
    finally:
        signal.signal(signal.SIGTERM, before)
