"""Lets SIGTERM and the end of the terminal end a piece of work with cleanup, as Ctrl-C does."""

import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import Any, ClassVar

from drcli.base.errors import DrError

STOPS = (signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a program to stop; the second comes when its terminal closes."""

Handlers = Mapping[signal.Signals, Any]
"""What handles signals, as `signal.signal` takes it."""


class Stopped(DrError):
    """SIGTERM or SIGHUP stopped the work."""

    code: ClassVar[int] = 143
    final: ClassVar[bool] = True


class _Terminated(BaseException):
    """A signal came. Not an Exception, so that `except Exception` does not catch it."""


def handle(
    handler: Callable[[int, FrameType | None], object],
    numbers: tuple[signal.Signals, ...] = (signal.SIGINT, *STOPS),
) -> Handlers:
    """Let a function handle Ctrl-C and what asks this program to stop; only in the main thread.

    An ignored SIGHUP stays ignored, because `nohup` has started a program that is to go on without
    its terminal.

    Returns:
        What handled these signals before, for `restore`.
    """
    kept = {signal.SIGHUP} if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else set()
    return {each: signal.signal(each, handler) for each in numbers if each not in kept}


def restore(before: Handlers) -> None:
    """Let signals do what they did before."""
    for number, handler in before.items():
        signal.signal(number, handler)


class NotedSignals:
    """Notes these signals while its `with` block runs, for work that ends at its own pace.

    Only in the main thread.

    Attributes:
        first: The first signal; None before one.
        count: How many have come. SIGHUP counts as the first only: a shell repeats it.
    """

    def __init__(self) -> None:
        self.first: signal.Signals | None = None
        self.count = 0

    def __enter__(self) -> "NotedSignals":
        """Note signals from now on."""
        self._before = handle(self._note)
        return self

    def __exit__(self, *_error: object) -> None:
        """Let signals do what they did before."""
        restore(self._before)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if self.first is not None and number == signal.SIGHUP:
            return
        self.first = self.first or signal.Signals(number)
        self.count += 1

    def refuse(self, message: str, remedy: str) -> None:
        """Return if no signal has come.

        Raises:
            KeyboardInterrupt: Ctrl-C has.
            Stopped: Another one has. It has this message and remedy.
        """
        if self.first == signal.SIGINT:
            raise KeyboardInterrupt
        if self.first is not None:
            raise Stopped(message, remedy=remedy)


@contextmanager
def until_sigterm(message: str, remedy: str) -> Iterator[None]:
    """Let SIGTERM or SIGHUP end the `with` block; only in the main thread.

    Raises:
        Stopped: One of them came. It has this message and remedy.
    """

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
