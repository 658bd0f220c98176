"""Runs work in threads, so that the supervisor's loop never waits for it."""

import queue
import threading
import time
from collections.abc import Callable

from drcli.base.errors import DrError
from drcli.base.log import get_logger

_logger = get_logger(__name__)


class Periodic:
    """Calls a function again and again; a failure is logged once."""

    def __init__(self, name: str, what: Callable[[], object], every_s: float) -> None:
        self._what = what
        self._every_s = every_s
        self._logged = ""
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
            self._attempt(call)
            try:
                call = self._errands.get(timeout=self._every_s)
            except queue.Empty:
                call = self._what

    def _attempt(self, call: Callable[[], object]) -> None:
        try:
            call()
            self._logged = ""
        except Exception as error:  # the thread must go on after any failure
            words = str(error) if isinstance(error, DrError) else f"{type(error).__name__}: {error}"
            if words != self._logged:
                self._logged = words
                bug = None if isinstance(error, DrError) else error
                _logger.warning("%s: %s", self._thread.name, words, exc_info=bug)


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
