"""Lets SIGTERM and SIGHUP end work with cleanup, as Ctrl-C does."""

import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import Any, ClassVar

from drcli.base.errors import DrError

STOPS = (signal.SIGTERM, signal.SIGHUP)
Handlers = Mapping[signal.Signals, Any]


class Stopped(DrError):
    """By SIGTERM or SIGHUP."""

    code: ClassVar[int] = 143
    final: ClassVar[bool] = True


class _Terminated(BaseException):
    """Not an Exception, so that `except Exception` does not catch it."""


def handle(
    handler: Callable[[int, FrameType | None], object],
    numbers: tuple[signal.Signals, ...] = (signal.SIGINT, *STOPS),
) -> Handlers:
    """For the main thread. Returns what handled signals before, for `restore`.

    An ignored SIGHUP stays so, because of `nohup`.
    """
    kept = {signal.SIGHUP} if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else set()
    return {each: signal.signal(each, handler) for each in numbers if each not in kept}


def restore(before: Handlers) -> None:
    """Undo `handle`."""
    for number, handler in before.items():
        signal.signal(number, handler)


class NotedSignals:
    """Notes signals in its `with` block; in the main thread.

    Attributes:
        count: SIGHUP counts only as the first: a shell repeats it.
    """

    def __init__(self) -> None:
        self.first: signal.Signals | None = None
        self.count = 0

    def __enter__(self) -> "NotedSignals":
        self._before = handle(self._note)
        return self

    def __exit__(self, *_error: object) -> None:
        restore(self._before)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if self.first is not None and number == signal.SIGHUP:
            return
        self.first = self.first or signal.Signals(number)
        self.count += 1

    def refuse(self, message: str, remedy: str) -> None:
        """Raise KeyboardInterrupt or Stopped if a signal has come."""
        if self.first == signal.SIGINT:
            raise KeyboardInterrupt
        if self.first is not None:
            raise Stopped(message, remedy=remedy)


@contextmanager
def until_sigterm(message: str, remedy: str) -> Iterator[None]:
    """Stopped ends the `with` block; main thread only."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise _Terminated

    before = handle(stop, STOPS)
    try:
        yield
    except _Terminated:
        raise Stopped(message, remedy=remedy) from None
    finally:
        restore(before)
