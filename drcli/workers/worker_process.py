"""Runs a worker as a process: its signals, its log, and why it ends."""

import gc
import logging
import os
import socket
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import FrameType

from drcli.base import errors, log
from drcli.base.errors import DrError
from drcli.base.installation import import_error, lazy_imports
from drcli.base.log import JsonLog, LogFile, RotatingLog, record_text
from drcli.base.processes import handle, lower_priority, search_as_usual
from drcli.bucket.connect import OUTAGE_PATIENCE_S, open_bucket
from drcli.bucket.request_count import CountFile
from drcli.bucket.s3_bucket import S3Bucket
from drcli.model import keys
from drcli.model.lease import OTHERS_TRUSTED_S, POINTER_TRUSTED_S, Ownership
from drcli.model.model_store import ModelStore
from drcli.records.job import Job, WorkerExit
from drcli.records.run_record import ActivityRecord, json_log, log_file, reward_log
from drcli.workers import print_limit
from drcli.workers.heartbeat_thread import Heartbeat, memory_shortage

with lazy_imports():
    from drcli.workers import reward_failures


# The logs of a worker: its own, as JSON lines, and what the racer's code prints.
#
# That is in its own log too, where other tools look for it.


def open_logs(job: Job, name: str, path: Path) -> list[RotatingLog]:
    """Besides the worker's own."""
    settings = job.config.logs
    max_bytes = settings.log_max_mb << 20
    LogFile(path, max_bytes)
    prints = _RewardLog(
        log_file(job.directory, job.config.model.prefix, reward_log(name)), max_bytes
    )
    logs: list[RotatingLog] = [prints]
    copies = [prints.file.write]
    if settings.log_json:
        lines = JsonLog(json_log(path), max_bytes, name)
        logs.append(lines)
        copies.append(lines.printed)
    print_limit.theirs.copies = copies
    return logs


class _RewardLog(RotatingLog):
    """Our records between the reward function's prints."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.name == print_limit.reward_logger.name:
            self.file.write(f"{record_text(record)}\n")


FAR_READ_TIMEOUT_S = 20.0
"""For a joined worker: after an interruption old connections hang; a new one works at once."""

BUG = 1
_logger = log.get_logger(__name__)


class StopSignal:
    """Knows whether this process should stop: a signal came, or its launcher has ended.

    A joined worker also stops when its training has ended; `ended` says why.
    """

    def __init__(self, launcher_pid: int) -> None:
        self.ended = ""
        self.heartbeat = Heartbeat()
        self._launcher_pid = launcher_pid
        self._signalled = False
        handle(self._note_signal)

    def _note_signal(self, _number: int, _frame: FrameType | None) -> None:
        self._signalled = True

    def should_stop(self) -> bool:
        self.heartbeat.turn()
        return self._is_over()

    def step_done(self) -> bool:
        """The same after each step, which counts as progress."""
        self.heartbeat.step_done()
        return self._is_over()

    def _is_over(self) -> bool:
        return self._signalled or bool(self.ended) or os.getppid() != self._launcher_pid


class StopRequested(Exception):
    """Ends a worker that was asked to stop."""


class Activity:
    """Publishes in the bucket, and in the heartbeat, what this worker is doing.

    Nobody waits for the bucket; what comes next meets the same failure.
    """

    def __init__(self, model: ModelStore, name: str, heartbeat: Heartbeat) -> None:
        self._bucket = model.bucket
        self._key = keys.status(model.prefix, name)
        self._heartbeat = heartbeat
        self._last = ""
        self._sender = ThreadPoolExecutor(1, thread_name_prefix="activity")
        self._unsent: Future[None] | None = None

    def wait(self, text: str) -> None:
        self.say(text, waits=True)

    def say(self, text: str, *, waits: bool = False) -> None:
        self._heartbeat.say(text, waits=waits)
        if text == self._last:
            return
        self._last = text
        record = ActivityRecord(text, time.time(), os.getpid(), socket.gethostname())
        if self._unsent is not None:
            self._unsent.cancel()
        self._unsent = self._sender.submit(self._bucket.put, self._key, record.encode())

    def close(self) -> None:
        self._sender.shutdown()


def open_own_bucket(job: Job, stop_signal: StopSignal, *, far: bool = False) -> S3Bucket:
    """The bucket of a training, for one of its workers.

    It refuses writes when another training has taken over the model. A `far` worker reads the
    lease less often, and repeats hanging requests sooner.
    """
    storage = job.config.storage
    # The embedded server is different: the supervisor restarts it if a worker gives up.
    patience = {} if storage.cloud == "local" else {"patience_s": OUTAGE_PATIENCE_S}
    if far:
        patience["read_timeout_s"] = FAR_READ_TIMEOUT_S
    bucket = open_bucket(storage, hurried=stop_signal.should_stop, unattended=True, **patience)
    trusted_s = OTHERS_TRUSTED_S if far else POINTER_TRUSTED_S
    prefix = job.config.model.prefix
    own = Ownership(
        ModelStore(bucket, prefix), job.session, job.term, trainer=job.trainer, trusted_s=trusted_s
    )
    return bucket.fenced(own.check)


def run(name: str, main: Callable[[Job, StopSignal], None]) -> None:
    """Run a worker's loop as the main function of a process.

    Exits with 0 if the loop ended or was asked to stop, with the code of an explained failure,
    or with 1 for a bug, whose traceback goes to the log. Without a readable job, only the log
    has the reason.
    """
    search_as_usual()
    job = Job.received_or_exit()
    stop_signal = StopSignal(job.launcher_pid)
    WorkerExit.delete(job.folder, name)
    path = os.environ.get(log.VARIABLE)
    logs = open_logs(job, name, Path(path)) if path else []
    # What `except Exception` does not see.
    sys.excepthook = lambda kind, error, trace: _explain(error, job, name)
    errors.show, errors.warn = _logger.info, _logger.warning
    _logger.info("%s started as process %d.", name, os.getpid())
    if job.config.train.priority == "low":
        _logger.info("DR_PRIORITY=low: %s.", lower_priority())
    requests = CountFile(job.folder, name, job.session)
    requests.start()
    stop_signal.heartbeat.start(job.folder, name)
    try:
        main(job, stop_signal)
    except StopRequested:
        _logger.info("Stopped, as requested.")
    except Exception as error:
        raise SystemExit(_explain(error, job, name).code) from None
    finally:
        requests.end()
        print_limit.theirs.report()
        for each in logs:
            each.end()
        # Otherwise Python searches all objects for garbage at exit, which takes nearly a second.
        gc.freeze()


def _explain(error: BaseException, job: Job, name: str) -> WorkerExit:
    print_limit.theirs.report()
    memory = memory_shortage(error)
    logger = _logger
    simulation_errors = sys.modules.get("drsim.errors")  # the trainer does without drsim
    if simulation_errors is not None and isinstance(error, simulation_errors.RewardError):
        error, logger = reward_failures.reward_failure(error), print_limit.reward_logger
    if isinstance(error, DrError):
        ended = WorkerExit.of(error)
        if memory:  # its own fault or not: a new process may have enough
            ended = replace(ended, final=False, memory=True)
        logger.error("%s %s", error, error.remedy)
    elif memory:
        ended = replace(memory, message=f"{name} {memory.message}")
        _logger.error("%s", ended.message, exc_info=error)
    elif broken := import_error(error):
        ended = WorkerExit.of(broken)
        _logger.error("%s %s", broken, broken.remedy, exc_info=error)
    else:
        text = f"{name} failed: {type(error).__name__}: {error}"
        ended = WorkerExit(text, f"Read its log with `dr-logs {name}` and report it as a bug.", BUG)
        _logger.error(ended.message, exc_info=error)
    ended.write(job.folder, name)
    return ended
