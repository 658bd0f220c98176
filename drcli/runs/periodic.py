"""Work that a supervisor does again and again beside its loop, which must never wait for it."""

import queue
import threading
import time
from collections.abc import Callable

from drcli.base.errors import DrError


class Periodic:
    """Calls a function every so often, in a thread of its own that ends with the process.

    Args:
        name: Of the thread.
        what: The work. A failure is said once and does not end it: there is a next time.
        every_s: Seconds between two calls.
        say: Told what went wrong.
    """

    def __init__(
        self, name: str, what: Callable[[], object], every_s: float, say: Callable[[str], None]
    ) -> None:
        self._what = what
        self._every_s = every_s
        self._say = say
        self._said = ""
        self._ended = False
        self._errands: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin with the first call."""
        self._thread.start()

    def stop(self, *, wait_s: float = 0.0) -> None:
        """Call no more; a call that is under way is left to itself after so many seconds."""
        self._ended = True
        self._errands.put(lambda: None)
        if self._thread.is_alive():
            self._thread.join(wait_s)

    def ask(self, errand: Callable[[], object]) -> threading.Event:
        """Have something else done by this thread as soon as it can.

        Returns:
            Set once it is done, well or not.
        """
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
            self._said = ""
        except Exception as error:  # a thread that dies unseen would be worse than any of them
            words = str(error) if isinstance(error, DrError) else f"{type(error).__name__}: {error}"
            if words != self._said:
                self._said = words
                self._say(words)


def within(
    seconds: float, call: Callable[[], object], give_up: Callable[[], bool] = lambda: False
) -> bool:
    """Call a function for no longer than so many seconds; what is left undone then is left.

    Args:
        seconds: How long.
        call: Says itself what went wrong.
        give_up: Whether to wait no longer.

    Returns:
        Whether it came to its end.
    """
    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    deadline = time.monotonic() + seconds
    while thread.is_alive() and time.monotonic() < deadline and not give_up():
        thread.join(0.1)
    return not thread.is_alive()
