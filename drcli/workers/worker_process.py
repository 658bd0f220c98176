"""What both kinds of worker share as processes: signals, last words, and a word on what they do."""

import gc
import json
import os
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable
from types import FrameType

from drcli.base.errors import DrError
from drcli.exchange.job import Job, LastWords
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.connect import open_bucket
from drcli.store.ownership import Ownership
from drcli.store.s3_bucket import S3Bucket
from drcli.workers import output

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


def open_own_bucket(job: Job, lifeline: Lifeline) -> S3Bucket:
    """The bucket of a training, for a worker of it.

    Nothing can be written there once another training has taken the model over, and the patience
    with a silent server is short once the worker was asked to leave.

    Args:
        job: The training.
        lifeline: Of this process.
    """
    bucket = open_bucket(job.config.storage, hurried=lifeline.should_stop)
    return bucket.fenced(Ownership(bucket, job.config.model.prefix, job.session, job.term).check)


def run(name: str, main: Callable[[Job, Lifeline], None]) -> None:
    """Run a worker's loop as the main function of a process.

    Exits 0 when the loop is done or was asked to stop, with an explained failure's own code, and
    with 1 for a bug, whose traceback goes to the log.
    """
    job = Job.received()
    lifeline = Lifeline(job.launcher_pid)
    LastWords.forget(job.folder, name)
    output.install(job.config.log_max_mb << 20)
    sys.excepthook = _hook(job, name)
    try:
        main(job, lifeline)
    except StopRequested:
        print(f"{name}: asked to stop, leaving.")
    except Exception as error:
        words = _words(name, error)
        words.leave(job.folder, name)
        _log(name, error)
        raise SystemExit(words.code) from None
    finally:
        output.end_limit()
        # Else Python looks through all objects for garbage while it ends, which takes most of a
        # second of processor time that whoever stops a training waits for.
        gc.freeze()


def _hook(job: Job, name: str) -> Callable[[type[BaseException], BaseException, object], None]:
    """What tells of an end that `except Exception` does not see.

    Where a reward function swallows everything that is raised to interrupt it, the simulation has
    this called and ends the process.
    """

    def tell(_kind: type[BaseException], error: BaseException, _trace: object) -> None:
        from drcli.workers.build_race import (
            reward_failure,  # here, because the trainer needs no drsim
        )
        from drsim.errors import RewardError

        known = reward_failure(error) if isinstance(error, RewardError) else error
        _words(name, known).leave(job.folder, name)
        _log(name, known)

    return tell


def _words(name: str, error: BaseException) -> LastWords:
    if isinstance(error, DrError):
        return LastWords.of(error)
    words = f"{name} failed: {type(error).__name__}: {error}"
    return LastWords(words, f"Read its log with `dr-logs {name}` and report it as a bug.", BUG)


def _log(name: str, error: BaseException) -> None:
    output.end_limit()
    if isinstance(error, DrError):
        print(f"{name}: {error} {error.remedy}", flush=True)
    else:
        traceback.print_exception(error, file=sys.stdout)
