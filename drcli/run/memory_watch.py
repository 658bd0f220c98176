"""Names a worker whose memory grows, and reacts when memory runs out."""

import signal
from collections.abc import Callable
from dataclasses import dataclass, field

import psutil

from drcli.base.clock import AwakeClock, Growth, Trend, duration
from drcli.base.errors import WorkerDied
from drcli.base.memory import MemoryState, read_memory
from drcli.base.system_calls import soft_limit
from drcli.records.job import WorkerExit
from drcli.run.duty import Duty, RunningTraining
from drcli.run.heartbeat_monitor import HEARTBEAT_POLL_S, HeartbeatMonitor
from drcli.run.outcome import Outcome
from drcli.run.smaller_run import SmallerRun
from drcli.run.worker_processes import TRAINER, Child
from drcli.workers.heartbeat_thread import REMEDY

POLL_S = 3.0
LEAST_S = 60.0
"""A fast leak fills a small container in minutes."""

GREW_BYTES, GREW_SHARE = 64e6, 0.1
"""Smaller growth, also as a share of what the worker had, is not named."""

WARN_S = 24 * 3600.0
"""Until growth fills the memory."""

FORESIGHT = 30.0
"""Growth is thought to go on for so many times its length. Longer episodes and viewers of the live
page also add 100 MB within a quarter of an hour.
"""

YOUNG_S = 600.0
"""In its first minutes a worker always grows."""

TIGHT_SHARE, TIGHT_BYTES = 0.03, 150e6
"""Memory is nearly full if less is left."""

TIGHT_S = 30.0
"""So long after memory was nearly full, a kill was for that."""

LEAK_GROWTH = 1.5
"""Growth by this factor gets a worker restarted when memory is nearly full."""


@dataclass
class Watched:
    pid: int
    since_s: float
    trend: Trend = field(default_factory=lambda: Trend(LEAST_S))
    bytes: int = 0
    named_bytes: float = 0.0


class MemoryWatch(Duty):
    """Warns of growing workers, and makes the run smaller after a kill for memory."""

    name = "memory watch"
    check_s = POLL_S

    def __init__(
        self,
        run: RunningTraining,
        clock: Callable[[], float] | None = None,
        read: Callable[[], MemoryState] = read_memory,
        size_of: Callable[[int], int | None] | None = None,
    ) -> None:
        super().__init__(run)
        self._clock = clock or AwakeClock()
        self._read = read
        self._size_of = size_of or resident_bytes
        self._workers: dict[str, Watched] = {}
        self._tight_s: float | None = None
        self._kill_s: float | None = None
        self._state = read()
        self._smaller = SmallerRun()

    def check(self) -> Outcome | None:
        now_s = self._clock()
        self._note_state(now_s)
        for child in self.run.children:
            if child.running and child.process is not None:
                self._measure(child, child.process.pid, now_s)
        self._look_for_tightness(now_s)
        return None

    def died(self, child: Child, code: int, exit_reason: WorkerExit | None) -> Outcome | None:
        watched = self._workers.pop(child.name, None)
        self.run.board.clear(f"memory of {child.name}")
        if self._smaller.note_excluded(child):
            return None
        told = exit_reason is not None and exit_reason.memory
        if not told and not (code == -signal.SIGKILL and not child.ended_by and self._ran_out()):
            return None
        had = f" It had {megabytes(watched.bytes)}." if watched is not None else ""
        if exit_reason is not None:
            what = exit_reason.message
        else:
            what = (
                f"{child.name} was killed because {self._state.place} was full.{had} "
                f"{self._others(child)}".rstrip()
            )
        growth = self._growth(watched) if watched is not None else None
        lived_s = 0.0 if watched is None else self._clock() - watched.since_s
        child.quick_deaths = 0  # not 25 restarts: there are only a few steps to something smaller
        if growth is not None:
            what += (
                f" It had grown from {megabytes(growth.begin)} in {duration(growth.seconds)}. "
                f"{_cause(child)}"
            )
        leaked = growth is not None and lived_s >= YOUNG_S
        if leaked or self._restart_leak(self._clock()):
            self.run.board.tell("fault", f"{what} It is started again.", worker=child.name)
            return None
        step = self._smaller.next_step(child, self.run)
        if step is not None:
            self.run.board.warn(
                "memory", f"{what} {step}", "recovery", worker=child.name, reason="memory"
            )
            return None
        code = exit_reason.code if exit_reason is not None else WorkerDied.code
        return Outcome(code, f"{what} The training cannot get any smaller.", REMEDY)

    def _measure(self, child: Child, pid: int, now_s: float) -> None:
        watched = self._workers.get(child.name)
        if watched is None or watched.pid != pid:
            watched = self._workers[child.name] = Watched(pid, now_s)
        size = self._size_of(pid)
        if not size:  # it is just being removed
            return
        watched.bytes = size
        watched.trend.add(now_s, size)
        growth = self._growth(watched)
        if growth is None or size < watched.named_bytes * LEAK_GROWTH:
            return
        full_s = self._state.available_bytes / growth.per_s
        young = now_s - watched.since_s < YOUNG_S
        if full_s > min(YOUNG_S if young else WARN_S, FORESIGHT * growth.seconds):
            return
        watched.named_bytes = size
        self.run.board.warn(
            f"memory of {child.name}",
            f"{child.name} grows steadily: {megabytes(growth.begin)} {duration(growth.seconds)} "
            f"ago, {megabytes(growth.end)} now. If it goes on like this, {self._state.place} is "
            f"full in {duration(full_s)}. {_cause(child)}",
            worker=child.name,
            bytes=size,
            bytes_per_minute=round(60.0 * growth.per_s),
            full_in_s=round(full_s),
        )

    def _growth(self, watched: Watched) -> Growth | None:
        return watched.trend.growth(GREW_BYTES, GREW_SHARE)

    def _look_for_tightness(self, now_s: float) -> None:
        if not is_tight(self._state):
            if self._tight_s is not None and now_s - self._tight_s > TIGHT_S:
                self._tight_s = None
                self.run.board.clear("full memory")
            return
        first = self._tight_s is None
        self._tight_s = now_s
        if self._restart_leak(now_s) or not first:
            return
        left = megabytes(self._state.available_bytes)
        self.run.board.warn(
            "full memory",
            f"Only {left} of {self._state.place} is left. {self._others()} "
            "If it runs out, the kernel kills a process.",
        )

    def _restart_leak(self, now_s: float) -> bool:
        """Before the kernel chooses a victim."""
        for child in self.run.children:
            watched = self._workers.get(child.name)
            if watched is None or child.name == TRAINER or not child.running:
                continue
            growth = self._growth(watched)
            if growth is None or now_s - watched.since_s < YOUNG_S:
                continue
            if watched.bytes >= LEAK_GROWTH * growth.begin:
                self.run.board.tell(
                    "fault",
                    f"{self._state.place} is nearly full, and {child.name} has grown from "
                    f"{megabytes(growth.begin)} to {megabytes(watched.bytes)}; it is restarted. "
                    f"{_cause(child)}",
                    worker=child.name,
                )
                child.kill_for("grown too large")
                return True
        return False

    def _ran_out(self) -> bool:
        now_s = self._clock()
        self._note_state(now_s)
        # The kernel counts the kill before it has removed the process.
        signs = (self._kill_s, self._tight_s)
        self._kill_s = None  # it explains one death
        return any(sign_s is not None and now_s - sign_s <= TIGHT_S for sign_s in signs)

    def _note_state(self, now_s: float) -> None:
        before, self._state = self._state, self._read()
        if self._state.kills > before.kills:
            self._kill_s = now_s

    def _others(self, without: Child | None = None) -> str:
        sizes = [
            f"{name} has {megabytes(watched.bytes)}"
            for name, watched in self._workers.items()
            if without is None or name != without.name
        ]
        return f"{', '.join(sizes)}." if sizes else ""


def resident_bytes(pid: int) -> int | None:
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:
        return None


def is_tight(state: MemoryState) -> bool:
    return state.available_bytes < max(TIGHT_SHARE * state.total_bytes, TIGHT_BYTES)


def megabytes(size: float) -> str:
    return f"{size / 1e6:,.0f} MB"


def _cause(child: Child) -> str:
    if child.name == TRAINER:
        return "With sac, it grows until its replay buffer (sac_replay_steps) is full."
    return "A reward function that keeps more and more data, such as in a global list, does this."


# Names a worker that opens more and more files.


MOST_OPEN = 0.7


def open_files_limit() -> int:
    """0 for any number."""
    return soft_limit("open_files") or 0


class OpenFilesWatch(Duty):
    name = "open files watch"
    check_s = HEARTBEAT_POLL_S

    def __init__(
        self,
        run: RunningTraining,
        heartbeats: HeartbeatMonitor,
        limit: Callable[[], int] = open_files_limit,
    ) -> None:
        super().__init__(run)
        self._heartbeats = heartbeats
        self._limit = limit()
        self._named: set[int] = set()

    def check(self) -> Outcome | None:
        for child in self.run.children:
            seen = self._heartbeats.of(child.name)
            subject = f"open files of {child.name}"
            if seen is None or seen.record is None:
                continue
            if seen.record.open_files <= MOST_OPEN * self._limit or self._limit <= 0:
                self.run.board.clear(subject)
            elif seen.pid not in self._named:
                self._named.add(seen.pid)
                self.run.board.warn(
                    subject,
                    f"{child.name} has {seen.record.open_files:,} open files and may have "
                    f"{self._limit:,}. A reward function that opens a file at each step and does "
                    "not close it does this.",
                    worker=child.name,
                )
        return None
