"""Says only once that a server does not answer."""

import threading
from collections.abc import Callable
from functools import lru_cache

from drcli.base import notices

_SAID_AGAIN_S = 60.0
_LONG_S = 10.0


class Outage:
    """Says once that a server is silent, and once that it is back."""

    def __init__(self, place: str, clock: Callable[[], float]) -> None:
        self._place = place
        self._clock = clock
        self._lock = threading.Lock()
        self._began_s: float | None = None
        self._told_s = -_SAID_AGAIN_S

    def note(self, began_s: float, reason: str = "") -> None:
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
    """Shared by all buckets and threads of this process."""
    return Outage(place, clock)
