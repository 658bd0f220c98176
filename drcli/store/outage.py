"""Says once that a server does not answer, however many calls notice it."""

import threading
from collections.abc import Callable
from functools import lru_cache

from drcli.base import notices

_SAID_AGAIN_S = 60.0
"""How long after an outage the next one is not worth a message."""

_LONG_S = 10.0
"""An outage whose end is worth a message."""


class Outage:
    """Says once that a server does not answer, and once that it answers again.

    Failures that come in quick succession are one outage.
    """

    def __init__(self, place: str, clock: Callable[[], float]) -> None:
        self._place = place
        self._clock = clock
        self._lock = threading.Lock()
        self._began_s: float | None = None
        self._told_s = -_SAID_AGAIN_S

    def note(self, began_s: float, reason: str = "") -> None:
        """Note that there has been no useful answer since then, and why not if that is known."""
        with self._lock:
            if self._began_s is not None:
                return
            self._began_s = began_s
            now_s = self._clock()
            told = now_s - self._told_s < _SAID_AGAIN_S
            self._told_s = now_s
        if not told:
            notices.show(reason or f"Waiting for an answer from {self._place} ...")

    def end(self) -> None:
        """Note an answer."""
        if self._began_s is None:
            return
        with self._lock:
            began_s, self._began_s = self._began_s, None
            now_s = self._clock()
            self._told_s = now_s
        if began_s is not None and now_s - began_s >= _LONG_S:
            notices.show(f"{self._place} answers again, after {now_s - began_s:.0f} s.")


@lru_cache(maxsize=16)
def outage_of(place: str, clock: Callable[[], float]) -> Outage:
    """The outage of a server, which all buckets of this process there share, in all threads."""
    return Outage(place, clock)
