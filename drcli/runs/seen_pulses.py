"""What a supervisor sees of its workers' pulses, on its own clock."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from drcli.base.elapsed import AwakeClock, duration
from drcli.exchange.pulse_record import PulseRecord
from drcli.runs.worker_processes import TRAINER, Child

LOOK_S = 2.0
QUIET_S = 10.0
"""Then a frozen worker uses no processor time."""


@dataclass
class Seen:
    """A worker process; times are those of `SeenPulses.now_s`.

    `turn_s`: when its main thread came by. `quiet_cpu_s`: processor time used `QUIET_S` after
    its last pulse.
    """

    pid: int
    since_s: float
    beat_s: float
    turn_s: float
    work_s: float | None = None
    quiet_cpu_s: float | None = None
    record: PulseRecord | None = None


class SeenPulses:
    def __init__(self, folder: Path, clock: Callable[[], float] | None = None) -> None:
        self._folder = folder
        self._clock = clock or AwakeClock()
        self._workers: dict[str, Seen] = {}
        self._looked_s = -LOOK_S
        self.now_s = 0.0
        """Seconds in which this supervisor ran, at the last look."""

    def look(self, children: Sequence[Child]) -> bool:
        self.now_s = self._clock()
        if self.now_s - self._looked_s < LOOK_S:
            return False
        self._looked_s = self.now_s
        for child in children:
            if child.running and child.process is not None:
                self._look_at(child.name, child.process.pid)
            else:
                self._workers.pop(child.name, None)
        return True

    def of(self, name: str) -> Seen | None:
        return self._workers.get(name)

    def silent_s(self, seen: Seen) -> float:
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
            seen = self._workers[name] = Seen(pid, now_s, now_s, now_s)
        record = PulseRecord.read(self._folder, name)
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
