"""Carries out a user's code with a deadline, and in this process only."""

import contextlib
import faulthandler
import os
import signal
import threading
from collections.abc import Callable, Iterator
from functools import cache
from time import monotonic  # which users' code may put elsewhere in time
from types import FrameType

REPEAT_S = 0.25
"""Time between two exceptions after a deadline, for a bare `except:` in a loop swallows them."""

PATIENCE_S = 5.0
"""How long they are raised in vain before the process has to end."""

STUCK = signal.SIGPROF if hasattr(signal, "SIGPROF") else None
"""What ends a process whose user's code is in one operation that lasts too long: Python raises
nothing before the operation ends. The stacks of all threads go to the standard error first."""

_STUCK_FACTOR = float(max(2, os.cpu_count() or 1))
"""Processor seconds of a process for one of the clock: other threads may compute beside."""

_STDERR = 2

_LEAST_S = 1e-3
"""What is left of a time that is over: 0 would stop the timer."""


class DeadlinePassed(BaseException):
    """Raised inside the user's code; no `except Exception` of theirs may swallow it."""


class Alarm:
    """Raises DeadlinePassed in a user's call that takes too long, again and again until it ends.

    Attributes:
        armed: Whether a call goes on. It ends by setting this to False, which unlike a function of
            ours nothing can interrupt.
    """

    def __init__(self, deadline_s: float, in_vain: Callable[[FrameType | None], object]) -> None:
        self.armed = False
        self._over = False
        self._deadline_s = deadline_s
        self._in_vain = in_vain
        self._begun_s = 0.0
        self._rings = 0
        self._last_s = _STUCK_FACTOR * (deadline_s + PATIENCE_S) if _may_end_stuck() else 0.0

    def begin(self) -> None:
        """A call begins. The timer is left as it is: to wind it would cost more than most calls."""
        self._begun_s = monotonic()
        self._rings = 0
        self.armed = True

    def wind(self) -> None:
        """Have the timer ring when the call has had its time, or the next one could have.

        Where that is not heard, because Python is inside one operation, a second timer ends it all.
        """
        if self._last_s:
            _switch.is_on = True
            signal.setitimer(signal.ITIMER_PROF, self._last_s)
        left_s = self._left_s() if self.armed else self._deadline_s
        signal.setitimer(signal.ITIMER_REAL, max(left_s, _LEAST_S), REPEAT_S)

    def stop(self) -> None:
        """No call follows. A ring that came before and is heard only now winds nothing any more."""
        self.armed = False
        self._over = True
        if self._last_s:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            _switch.is_on = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def ring(self, _signal: int, frame: FrameType | None) -> None:
        """The timer has rung, perhaps for an earlier call than the one that goes on."""
        if self._over:
            return
        if not self.armed or self._left_s() > 0.0:
            self.wind()
            return
        if self._rings * REPEAT_S >= PATIENCE_S:
            self.armed = False  # nothing may interrupt the last words
            self._in_vain(frame)
        self._rings += 1
        raise DeadlinePassed

    def _left_s(self) -> float:
        return self._begun_s + self._deadline_s - monotonic()


@contextlib.contextmanager
def alarm(deadline_s: float, in_vain: Callable[[FrameType | None], object]) -> Iterator[Alarm]:
    """Install the timer once for many calls.

    It works in the main thread only, and only where the system has such timers.

    Args:
        deadline_s: How long each call may take.
        in_vain: Ends the process, where the code at this frame swallows all that is raised.
    """
    clock = Alarm(deadline_s, in_vain)
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
        if left_s:  # somebody else's timer ran before: it goes on, less the time we took
            rest_s = max(left_s - (monotonic() - since_s), _LEAST_S)
            signal.setitimer(signal.ITIMER_REAL, rest_s, interval_s)


class _Switch:
    """Whether it is we who have set the second timer of this process."""

    is_on = False


_switch = _Switch()


def _may_end_stuck() -> bool:
    """Whether the second timer is free: a profiler may use it, and its signal.

    One that Ctrl-C kept us from stopping is ours, too.
    """
    if STUCK is None or (signal.getitimer(signal.ITIMER_PROF)[0] and not _switch.is_on):
        return False
    if signal.getsignal(STUCK) is not signal.SIG_DFL:
        return False
    _show_stacks(STUCK)
    return True


@cache
def _show_stacks(number: signal.Signals) -> None:
    """Have a signal show where Python is before it ends the process."""
    faulthandler.register(number, file=_STDERR, chain=True)


def end_copy_of(process: int) -> None:
    """End this process if it is a copy of that one, which the user's code has made by forking."""
    if os.getpid() != process:
        os._exit(0)
