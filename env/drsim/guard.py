"""Carries out a user's code with a deadline, and in this process only."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import NoReturn


class DeadlinePassed(BaseException):
    """Raised inside the user's code; no `except Exception` of theirs may swallow it."""


@contextlib.contextmanager
def alarm() -> Iterator[Callable[[float], None]]:
    """Install the timer once for many calls; yields the function that winds it, 0 stops it."""
    usable = hasattr(signal, "setitimer") and (
        threading.current_thread() is threading.main_thread()
    )
    if not usable:
        yield lambda _: None
        return
    handler_before = signal.signal(signal.SIGALRM, _on_alarm)
    since = time.monotonic()
    left_s, interval_s = signal.setitimer(signal.ITIMER_REAL, 0.0)

    def arm(seconds: float) -> None:
        signal.setitimer(signal.ITIMER_REAL, seconds)

    try:
        yield arm
    finally:
        arm(0.0)
        signal.signal(signal.SIGALRM, handler_before)
        if left_s:  # somebody else's timer ran before: it goes on, less the time we took
            rest_s = max(left_s - (time.monotonic() - since), 1e-3)
            signal.setitimer(signal.ITIMER_REAL, rest_s, interval_s)


def end_copy_of(process: int) -> None:
    """End this process if it is a copy of that one, which the user's code has made by forking."""
    if os.getpid() != process:
        os._exit(0)


def _on_alarm(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise DeadlinePassed
