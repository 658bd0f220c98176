"""Runs work in threads, so that the supervisor's loop never waits for it."""

import queue
import threading
import time
from collections.abc import Callable
from typing import TypeVar

from drcli.base.errors import DrError
from drcli.base.log import get_logger

_logger = get_logger(__name__)

T = TypeVar("T")


class Guard:
    """Calls what must not end its caller; a failure is logged once, until the next success."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._logged = ""

    def call(self, what: Callable[[], T]) -> T | None:
        try:
            result = what()
        except Exception as error:  # the caller must go on after any failure
            if isinstance(error, DrError):
                words, bug = f"{error} {error.remedy}".rstrip(), None
            else:
                words, bug = f"{type(error).__name__}: {error}", error
            if words != self._logged:
                self._logged = words
                _logger.warning("%s: %s", self._name, words, exc_info=bug)
            return None
        self._logged = ""
        return result


class Periodic:
    """Calls a function again and again; a failure is logged once."""

    def __init__(self, name: str, what: Callable[[], object], every_s: float) -> None:
        self._what = what
        self._every_s = every_s
        self._guard = Guard(name)
        self._ended = False
        self._errands: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, *, wait_s: float = 0.0) -> None:
        self._ended = True
        self._errands.put(lambda: None)
        if self._thread.is_alive():
            self._thread.join(wait_s)

    def finish(
        self,
        errand: Callable[[], object],
        patience_s: float,
        give_up: Callable[[], bool] = lambda: False,
    ) -> None:
        """Do an errand, the last one."""
        done = self.ask(errand)
        within(patience_s, lambda: done.wait(patience_s), give_up)
        self.stop()

    def ask(self, errand: Callable[[], object]) -> threading.Event:
        done = threading.Event()

        def do() -> None:
            try:
                errand()
            finally:
                done.set()

        self._errands.put(do)
        return done

    def _run(self) -> None:
        call = self._what
        while not self._ended:
            self._guard.call(call)
            try:
                call = self._errands.get(timeout=self._every_s)
            except queue.Empty:
                call = self._what


def within(
    seconds: float, call: Callable[[], object], give_up: Callable[[], bool] = lambda: False
) -> bool:
    """Whether a function, which reports its failures itself, ends in time."""
    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    deadline = time.monotonic() + seconds
    while thread.is_alive() and time.monotonic() < deadline and not give_up():
        thread.join(0.1)
    return not thread.is_alive()
