"""Lets SIGTERM end a piece of work with cleanup, as Ctrl-C does."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import ClassVar

from drcli.base.errors import DrError


class Stopped(DrError):
    """SIGTERM stopped the work."""

    code: ClassVar[int] = 143
    final: ClassVar[bool] = True


class _Terminated(BaseException):
    """SIGTERM came. Not an Exception, so that `except Exception` does not catch it."""


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
