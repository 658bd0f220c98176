"""What both kinds of worker share as processes: signals, last words, and a word on what they do."""

import json
import os
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable
from types import FrameType

from drcli.errors import DrError
from drcli.job import Job, LastWords
from drcli.store import keys
from drcli.store.bucket import Bucket

BUG = 1
"""Exit code of a failure that is nobody's but ours."""


class Lifeline:
    """Knows whether this process should end: a signal came, or its launcher is gone."""

    def __init__(self, launcher_pid: int) -> None:
        self._launcher_pid = launcher_pid
        self._signalled = False
        signal.signal(signal.SIGTERM, self._note)
        signal.signal(signal.SIGINT, self._note)

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        self._signalled = True

    def should_stop(self) -> bool:
        """Whether to leave at the next good moment."""
        return self._signalled or os.getppid() != self._launcher_pid


class StopRequested(Exception):
    """Raised where a worker leaves because it was asked to."""


class Activity:
    """Tells everybody who looks into the bucket what this worker is doing."""

    def __init__(self, bucket: Bucket, prefix: str, name: str) -> None:
        self._bucket = bucket
        self._key = keys.status(prefix, name)
        self._last = ""

    def say(self, text: str) -> None:
        """Publish a few words, if they are news."""
        if text == self._last:
            return
        self._last = text
        record = {
            "activity": text,
            "since": time.time(),
            "pid": os.getpid(),
            "host": socket.gethostname(),
        }
        self._bucket.put(self._key, json.dumps(record).encode())


def run(name: str, main: Callable[[Job, Lifeline], None]) -> None:
    """Run a worker's loop as the main function of a process.

    Exits 0 when the loop is done or was asked to stop, with an explained failure's own code, and
    with 1 for a bug, whose traceback goes to the log.
    """
    job = Job.from_environment()
    lifeline = Lifeline(job.launcher_pid)
    LastWords.forget(job.folder, name)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    try:
        main(job, lifeline)
    except StopRequested:
        print(f"{name}: asked to stop, leaving.")
    except DrError as error:
        print(f"{name}: {error} {error.remedy}")
        LastWords.of(error).leave(job.folder, name)
        raise SystemExit(error.code) from None
    except Exception as error:
        traceback.print_exc(file=sys.stdout)
        words = f"{name} failed: {type(error).__name__}: {error}"
        remedy = f"Read its log with `dr-logs {name}` and report it as a bug."
        LastWords(words, remedy, BUG).leave(job.folder, name)
        raise SystemExit(BUG) from None
