"""Writes the heartbeat of this worker, by which its supervisor sees that it lives.

A thread writes it to a file, also during one long call of the main thread.
"""

import errno
import faulthandler
import os
import signal
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path

from drcli.base.clock import elapsed_s
from drcli.base.errors import WorkerDied
from drcli.base.installation import lazy_imports
from drcli.base.log import get_logger
from drcli.base.system_calls import open_files
from drcli.records.heartbeat import (
    HeartbeatRecord,
    heartbeat_file,
    open_heartbeat_file,
    short_activity,
)
from drcli.records.job import WorkerExit

with lazy_imports():
    import psutil

BEAT_S = 2.0
MOST_BEATS = 6
"""Ten seconds: a learner works in bursts."""

STACKS_SIGNAL = getattr(signal, "SIGUSR2", None)
"""A worker writes the stacks of its threads into its log, and goes on."""

companions: set[int] = set()
"""Processes that work for this one alone."""

_logger = get_logger(__name__)


class Heartbeat:
    """Only the main thread calls `turn`, `step_done` and `say`."""

    def __init__(self) -> None:
        self._activity = "starting"
        self._waits = False
        self._work = 0
        self._worked_s: float | None = None
        self._turned_s = elapsed_s()
        self._beats = 0
        self._relayed: HeartbeatRecord | None = None
        self._pid = os.getpid()
        self._used: deque[tuple[float, float]] = deque(maxlen=MOST_BEATS)

    def turn(self) -> None:
        self._turned_s = elapsed_s()

    def step_done(self) -> None:
        self._work += 1
        self._worked_s = self._turned_s = elapsed_s()

    def say(self, activity: str, *, waits: bool) -> None:
        self._activity, self._waits = activity, waits

    def relay(self, record: HeartbeatRecord) -> None:
        """Note the heartbeat of a worker on another machine, for which this process stands.

        Its times are of the clock there, so only their changes count.
        """
        before, self._relayed = self._relayed, record
        self.say(record.activity, waits=record.waits)
        if record.work != (0 if before is None else before.work):
            self._work = record.work
            self._worked_s = self._turned_s = elapsed_s()
        elif before is None or record.turned_s != before.turned_s:
            self.turn()

    @property
    def activity(self) -> tuple[str, bool]:
        return self._activity, self._waits

    def start(self, folder: Path, name: str) -> None:
        """On a full disk, the worker goes on without a heartbeat."""
        if STACKS_SIGNAL is not None:
            faulthandler.register(STACKS_SIGNAL, file=sys.__stderr__ or 2, all_threads=True)
        try:
            descriptor = open_heartbeat_file(folder, name)
        except OSError as error:
            _logger.warning("The heartbeat of this worker cannot be written: %s", error)
            return
        threading.Thread(
            target=self._beat, args=(folder, name, descriptor), name="heartbeat", daemon=True
        ).start()

    def record(self) -> HeartbeatRecord:
        relayed = self._relayed
        return HeartbeatRecord(
            pid=self._pid,
            beats=self._beats,
            written_s=elapsed_s(),
            activity=short_activity(self._activity),
            waits=self._waits,
            work=self._work,
            worked_s=self._worked_s,
            turned_s=self._turned_s,
            memory_bytes=relayed.memory_bytes if relayed else own_memory_bytes(),
            open_files=relayed.open_files if relayed else own_open_files(),
            cores=relayed.cores if relayed else self._cores(),
        )

    def _cores(self) -> float:
        """Processor time that was used, by all time, since some beats ago."""
        self._used.append((elapsed_s(), own_processor_s()))
        (before_s, used_s), (now_s, used_now_s) = self._used[0], self._used[-1]
        passed_s = now_s - before_s
        return round(max(0.0, used_now_s - used_s) / passed_s, 2) if passed_s > 0 else 0.0

    def _beat(self, folder: Path, name: str, descriptor: int) -> None:
        while True:
            self._beats += 1
            with suppress(OSError):
                if not heartbeat_file(folder, name).exists():  # somebody has removed the folder
                    fresh = open_heartbeat_file(folder, name)
                    os.close(descriptor)
                    descriptor = fresh
                os.pwrite(descriptor, self.record().file_content(), 0)
            time.sleep(BEAT_S)


def own_open_files() -> int:
    """Of this process, or of a companion with more."""
    return max(open_files(), *(open_files(each) for each in [*companions]), 0)


def own_processor_s() -> float:
    """Processor time of this process and its `companions`, all threads."""
    total = time.process_time()
    for each in [*companions]:
        with suppress(psutil.Error):  # it has just ended
            times = psutil.Process(each).cpu_times()
            total += times.user + times.system
    return total


def own_memory_bytes() -> int:
    """With its `companions` (resident sets)."""
    total = 0
    for each in (os.getpid(), *companions):
        with suppress(psutil.Error):  # it has just ended
            total += int(psutil.Process(each).memory_info().rss)
    return total


# Recognises that a worker failed because memory ran out, which is not a bug.


REMEDY = (
    "Give the training more memory, end other programs, or lower DR_WORKERS, DR_TRAIN_LANES, "
    "DR_TRAIN_MAX_STEPS_PER_ITERATION or (with sac) sac_replay_steps; then continue with "
    "`dr-start-training --resume`."
)
_GPU_REMEDY = (
    "End other programs on the GPU, lower batch_size, or learn on the processor with "
    "DR_SAGEMAKER_CUDA_DEVICES=-1 in system.env; then continue with `dr-start-training --resume`."
)

_WORDS = ("allocate memory", "bad_alloc")
"""Of torch and C++ libraries."""

_SHOWN_CHARACTERS = 200


def memory_shortage(error: BaseException) -> WorkerExit | None:
    """The failure of a worker if memory ran out; else None.

    That of a GPU is not `memory`: fewer cars and workers would not help.
    """
    text = f"{type(error).__name__}: {' '.join(str(error).split())[:_SHOWN_CHARACTERS]}"
    causes = (error, error.__cause__)
    if any(type(cause).__name__ == "OutOfMemoryError" for cause in causes):  # torch's, of a GPU
        return WorkerExit(f"ran out of GPU memory ({text}).", _GPU_REMEDY, WorkerDied.code)
    if not any(map(_says_so, causes)):
        return None
    used = own_memory_bytes() / 1e6
    what = f"ran out of memory: it uses {used:,.0f} MB and could not get more ({text})."
    return WorkerExit(what, REMEDY, WorkerDied.code, memory=True)


def _says_so(error: BaseException | None) -> bool:
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    if isinstance(error, RuntimeError):
        return any(words in str(error) for words in _WORDS)
    return isinstance(error, MemoryError)
