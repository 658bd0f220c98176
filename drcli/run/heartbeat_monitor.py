"""What a supervisor sees of its workers' heartbeats, on its own clock."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import psutil

from drcli.base.clock import AwakeClock, duration, elapsed_s
from drcli.records.heartbeat import HeartbeatRecord
from drcli.run.worker_processes import TRAINER, Child

HEARTBEAT_POLL_S = 2.0
QUIET_S = 10.0
"""Without a heartbeat; a frozen worker uses no processor time from then on."""


@dataclass
class WorkerHeartbeat:
    """A worker process; times are those of `HeartbeatMonitor.now_s`.

    `turn_s`: when its main thread came by. `quiet_cpu_s`: processor time used `QUIET_S` after
    its last heartbeat.
    """

    pid: int
    since_s: float
    beat_s: float
    turn_s: float
    work_s: float | None = None
    quiet_cpu_s: float | None = None
    record: HeartbeatRecord | None = None


class HeartbeatMonitor:
    def __init__(self, folder: Path, clock: Callable[[], float] | None = None) -> None:
        self._folder = folder
        self._clock = clock or AwakeClock()
        self._workers: dict[str, WorkerHeartbeat] = {}
        self.now_s = 0.0
        """Seconds in which this supervisor ran, at the last look."""

    def look(self, children: Sequence[Child]) -> None:
        self.now_s = self._clock()
        for child in children:
            if child.running and child.process is not None:
                self._look_at(child.name, child.process.pid)
            else:
                self._workers.pop(child.name, None)

    def of(self, name: str) -> WorkerHeartbeat | None:
        return self._workers.get(name)

    def silent_s(self, seen: WorkerHeartbeat) -> float:
        return self.now_s - seen.beat_s

    def describe(self, name: str) -> str:
        seen = self.of(name)
        if seen is None:
            return "not running"
        silent = self.silent_s(seen)
        words = "alive" if silent < QUIET_S else f"silent for {duration(silent)}"
        unit = "gradient step" if name == TRAINER else "frame"
        if seen.work_s is None:
            return f"{words}, no {unit} since its start {duration(self.now_s - seen.since_s)} ago"
        return f"{words}, last {unit} {duration(self.now_s - seen.work_s)} ago"

    def _look_at(self, name: str, pid: int) -> None:
        now_s, seen = self.now_s, self._workers.get(name)
        if seen is None or seen.pid != pid:
            seen = self._workers[name] = WorkerHeartbeat(pid, now_s, now_s, now_s)
        record = HeartbeatRecord.read(self._folder, name)
        before = seen.record
        if record is not None and record.pid == pid and record != before:
            seen.beat_s, seen.quiet_cpu_s = now_s, None
            if before is None or record.turned_s != before.turned_s:
                seen.turn_s = now_s
            if record.work != (0 if before is None else before.work):
                seen.work_s = now_s
            seen.record = record
        elif seen.quiet_cpu_s is None and now_s - seen.beat_s >= QUIET_S:
            seen.quiet_cpu_s = cpu_s(pid)


def cpu_s(pid: int) -> float | None:
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return None
    return float(times.user + times.system)


# What a worker's heartbeat says to other programs here.


SILENT_S = 10.0


@dataclass(frozen=True)
class WorkerHealth:
    """How a worker is."""

    steps: Annotated[
        int, "Finished steps of driving (all cars at once) or of learning since its start."
    ]
    progress_age_s: Annotated[
        float | None, "How long ago the last of them was finished; null before the first."
    ]
    pulse_age_s: Annotated[
        float, "How long ago it wrote its heartbeat; it does so every two seconds."
    ]
    memory_mb: Annotated[float, "Memory of its process (resident set), in millions of bytes."]
    open_files: Annotated[int, "Number of its open files; 0 if unknown."]
    cores: Annotated[
        float, "Cores that it kept busy on average in the last ten seconds; 0 if unknown."
    ] = 0.0

    @staticmethod
    def of(folder: Path, name: str, pid: int | None) -> "WorkerHealth | None":
        """The health of a worker process; None if it has no heartbeat, or one of another boot."""
        heartbeat = HeartbeatRecord.read(folder, name)
        now_s = elapsed_s()
        if heartbeat is None or heartbeat.pid != pid or heartbeat.written_s > now_s:
            return None
        worked_s = heartbeat.worked_s
        return WorkerHealth(
            steps=heartbeat.work,
            progress_age_s=None if worked_s is None else round(max(0.0, now_s - worked_s), 1),
            pulse_age_s=round(now_s - heartbeat.written_s, 1),
            memory_mb=round(heartbeat.memory_bytes / 1e6, 1),
            open_files=heartbeat.open_files,
            cores=heartbeat.cores,
        )

    def words(self, name: str) -> str:
        """Progress, memory and processor for people."""
        unit = "gradient step" if name == TRAINER else "frame"
        age_s = self.progress_age_s
        parts = [f"no {unit} yet" if age_s is None else f"last {unit} {duration(age_s)} ago"]
        if self.pulse_age_s > SILENT_S:
            parts.append(f"silent for {duration(self.pulse_age_s)}")
        parts.append(f"{self.memory_mb:,.0f} MB")
        if self.cores:
            parts.append(f"{self.cores:.1f} cores")
        return ", ".join(parts)
