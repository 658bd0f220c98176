"""Replaces workers that no longer run: stopped by a signal, or inside a system call.

Such a process lives, but has no pulse and uses no processor time.
"""

import psutil

from drcli.base.elapsed import duration
from drcli.exchange.job import WorkerExit
from drcli.runs.duty import Duty, RunningTraining
from drcli.runs.outcome import Outcome
from drcli.runs.seen_pulses import Seen, SeenPulses, cpu_s
from drcli.runs.warnings_board import WarningsBoard
from drcli.runs.worker_processes import STACKS_S, Child

FROZEN_S = 30.0
STARTING_S = 120.0
"""It loads libraries, perhaps from a slow disk."""

BUSY_S = 120.0
"""One operation never lets Python go on."""

USED_S = 0.05
REMOVAL_S = 10.0
_STATES = {
    psutil.STATUS_STOPPED: "stopped by a signal",
    psutil.STATUS_DISK_SLEEP: "waiting for a disk or network drive",
}


class FrozenWatch(Duty):
    name = "frozen workers"

    def __init__(self, pulses: SeenPulses, board: WarningsBoard) -> None:
        self._pulses = pulses
        self._board = board
        self._killed: dict[int, float] = {}
        self._asked: dict[int, float] = {}

    def start(self, run: RunningTraining) -> None:
        self._run = run
        self._board.begin(run.journal)

    def check(self) -> Outcome | None:
        if not self._pulses.look(self._run.children):
            return None
        for child in self._run.children:
            seen = self._pulses.of(child.name)
            if seen is None or child.process is None:
                continue
            if seen.pid in self._killed:
                if self._pulses.now_s - self._killed[seen.pid] > REMOVAL_S:
                    child.give_up()
            else:
                self._look_at(child, seen)
        return None

    def died(self, child: Child, code: int, words: WorkerExit | None) -> Outcome | None:
        if child.process is not None:
            self._killed.pop(child.process.pid, None)
            self._asked.pop(child.process.pid, None)
        return None

    def _look_at(self, child: Child, seen: Seen) -> None:
        silent_s = self._pulses.silent_s(seen)
        if silent_s < (FROZEN_S if seen.record is not None else STARTING_S):
            self._asked.pop(seen.pid, None)
            return
        try:
            state = psutil.Process(seen.pid).status()
        except psutil.Error:
            return  # it has just ended
        used_s = cpu_s(seen.pid)
        idle = used_s is None or used_s - (seen.quiet_cpu_s or 0.0) < USED_S
        if state == psutil.STATUS_STOPPED or (idle and state != psutil.STATUS_TRACING_STOP):
            how = _STATES.get(state, "without using the processor")
            self._replace(child, seen, f"was frozen for {duration(silent_s)} ({how})")
        elif silent_s >= BUSY_S and not idle:
            self._replace_busy(child, seen, silent_s)

    def _replace_busy(self, child: Child, seen: Seen, silent_s: float) -> None:
        now_s = self._pulses.now_s
        if seen.pid not in self._asked and seen.record is not None:
            child.ask_stacks()
            self._asked[seen.pid] = now_s
        if now_s - self._asked.get(seen.pid, -STACKS_S) >= STACKS_S:
            how = "was inside one operation that Python cannot interrupt"
            self._replace(child, seen, f"{how} for {duration(silent_s)}")

    def _replace(self, child: Child, seen: Seen, what: str) -> None:
        self._killed[seen.pid] = self._pulses.now_s
        child.kill_for("frozen")
        self._board.tell("fault", f"{child.name} {what}; it is replaced.", worker=child.name)
