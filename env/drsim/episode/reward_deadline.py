"""Runs a user's code with a deadline, and in this process only."""

import contextlib
import faulthandler
import os
import signal
import threading
from collections.abc import Callable, Iterator
from functools import cache
from time import monotonic  # the function itself: users' code may replace `time.monotonic`
from types import FrameType

REPEAT_S = 0.25
"""Between exceptions after a deadline: a bare `except:` in a loop swallows the first."""

PATIENCE_S = 5.0
"""Until the process ends."""

STUCK = signal.SIGPROF if hasattr(signal, "SIGPROF") else None
"""Ends a process inside one endless operation; all stacks go to standard error first."""

_STUCK_FACTOR = float(max(2, os.cpu_count() or 1))
"""Processor seconds per second: other threads may compute too."""

_STDERR = 2

_LEAST_S = 1e-3


class DeadlinePassed(BaseException):
    """Raised inside the user's code; `except Exception` does not catch it."""


class Alarm:
    """Raises DeadlinePassed in a call that takes too long, again and again until it ends.

    A call ends by setting `armed` to False: unlike a function call, nothing can interrupt that.
    """

    may_end = False

    def __init__(self, deadline_s: float, give_up: Callable[[FrameType | None], object]) -> None:
        self.armed = False
        self._over = False
        self._deadline_s = deadline_s
        self._give_up = give_up
        self._begun_s = 0.0
        self._rings = 0
        self._last_s = _STUCK_FACTOR * (deadline_s + PATIENCE_S) if _may_end_stuck() else 0.0

    def begin(self) -> None:
        """The timer runs on: setting it again would cost more than most calls."""
        self._begun_s = monotonic()
        self._rings = 0
        self.armed = True

    def wind(self) -> None:
        """Set the timer to the earliest deadline.

        If Python cannot react, a second one ends the process.
        """
        if self._last_s:
            Alarm.may_end = True
            signal.setitimer(signal.ITIMER_PROF, self._last_s)
        left_s = self._left_s() if self.armed else self._deadline_s
        signal.setitimer(signal.ITIMER_REAL, max(left_s, _LEAST_S), REPEAT_S)

    def stop(self) -> None:
        self.armed = False
        self._over = True
        if self._last_s:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            Alarm.may_end = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def ring(self, _signal: int, frame: FrameType | None) -> None:
        """The signal may be meant for an earlier call."""
        if self._over:
            return
        if not self.armed or self._left_s() > 0.0:
            self.wind()
            return
        if self._rings * REPEAT_S >= PATIENCE_S:
            self.armed = False  # nothing may interrupt the last message
            self._give_up(frame)
        self._rings += 1
        raise DeadlinePassed

    def _left_s(self) -> float:
        return self._begun_s + self._deadline_s - monotonic()


@contextlib.contextmanager
def alarm(deadline_s: float, give_up: Callable[[FrameType | None], object]) -> Iterator[Alarm]:
    """Install the timer for many calls, in the main thread, where the system has such timers.

    `give_up` ends the process when code swallows all exceptions.
    """
    clock = Alarm(deadline_s, give_up)
    usable = hasattr(signal, "setitimer") and (
        threading.current_thread() is threading.main_thread()
    )
    if not usable:
        yield clock
        return
    handler_before = signal.signal(signal.SIGALRM, clock.ring)
    since_s = monotonic()
    left_s, interval_s = signal.getitimer(signal.ITIMER_REAL)
    try:
        clock.wind()
        yield clock
    finally:
        clock.stop()
        signal.signal(signal.SIGALRM, handler_before)
        if left_s:  # another timer ran before: it goes on, less the time we took
            rest_s = max(left_s - (monotonic() - since_s), _LEAST_S)
            signal.setitimer(signal.ITIMER_REAL, rest_s, interval_s)


def _may_end_stuck() -> bool:
    if STUCK is None or (signal.getitimer(signal.ITIMER_PROF)[0] and not Alarm.may_end):
        return False
    if signal.getsignal(STUCK) is not signal.SIG_DFL:
        return False
    _show_stacks(STUCK)
    return True


@cache
def _show_stacks(number: signal.Signals) -> None:
    faulthandler.register(number, file=_STDERR, chain=True)


def end_copy_of(process: int) -> None:
    """End this process if it is a copy of that one, made by a fork in the user's code."""
    if os.getpid() != process:
        os._exit(0)
