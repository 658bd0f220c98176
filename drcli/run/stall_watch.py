"""Notices that a training makes no progress, and restarts stuck workers.

Progress is a finished step of any worker, so a huge iteration or a slow reward function is not
a stall.
"""

from collections.abc import Sequence

import psutil

from drcli.base.clock import duration
from drcli.base.errors import StorageError, WorkerDied
from drcli.records.job import WorkerExit
from drcli.run.duty import Duty, RunningTraining
from drcli.run.heartbeat_monitor import (
    HEARTBEAT_POLL_S,
    HeartbeatMonitor,
    WorkerHeartbeat,
    cpu_s,
)
from drcli.run.outcome import Outcome
from drcli.run.worker_processes import STACKS_S, TRAINER, Child

TURN_S = 60.0
"""Then its main thread is stuck in one call."""

MOST_STALLS = 3
"""Without an update between them, no iteration will finish."""


class StallWatch(Duty):
    name = "stall watch"
    check_s = HEARTBEAT_POLL_S

    def __init__(self, run: RunningTraining, heartbeats: HeartbeatMonitor) -> None:
        super().__init__(run)
        self._stall_s = 60.0 * run.job.config.unattended.stall_minutes
        self._heartbeats = heartbeats
        # When the present quiet time began, and when anybody worked.
        self._since_s = self._worked_s = heartbeats.now_s
        self._update_s = self._excused_s = heartbeats.now_s
        self._told_s = 0.0
        self._restarted = False
        self._stalls = 0
        self._stuck: list[tuple[Child, int]] = []
        self._kill_at_s = 0.0
        self._silent_bucket_s: float | None = None

    def check(self) -> Outcome | None:
        now_s = self._heartbeats.now_s
        if self._stall_s == 0.0:
            return None
        if self._stuck:
            if now_s >= self._kill_at_s:
                self._kill_stuck()
            return None
        if self._note_progress():
            if now_s - self._worked_s < self._stall_s / 2.0:  # somebody works just now
                self._tell_of_missing_update()
                self._restart_single()
            return None
        if now_s - self._since_s < self._stall_s:
            return None
        what = f"No progress for {duration(now_s - self._since_s)}: {self._situation()}."
        self._stalls += 1
        if self._restarted or self._stalls >= MOST_STALLS:
            return Outcome(
                WorkerDied.code,
                f"{what} Restarting the workers did not help.",
                "Everything learned so far is kept. Read where the workers are stuck with "
                "`dr-logs trainer` and `dr-logs sim`, then continue with "
                "`dr-start-training --resume`.",
            )
        self.run.board.warn("stall", f"{what} The stuck workers are restarted once.", "fault")
        self._restarted = True
        self._prepare_to_kill(self._blamed())
        return None

    def died(self, child: Child, code: int, exit_reason: WorkerExit | None) -> Outcome | None:
        """While the bucket does not answer, no worker is to blame."""
        if exit_reason is not None and (
            exit_reason.silent or exit_reason.code == StorageError.code
        ):
            now_s = self._heartbeats.now_s
            self._since_s = self._update_s = self._excused_s = now_s
            if self._silent_bucket_s is None:
                self._silent_bucket_s = now_s
            away = duration(max(60.0, now_s - self._silent_bucket_s))
            self.run.board.show(
                "bucket",
                f"The bucket has failed workers for {away}: {exit_reason.message} The training "
                "goes on when it answers again.",
            )
        return None

    def _note_progress(self) -> bool:
        works = [seen.work_s for _, seen in self._seen() if seen.work_s is not None]
        newest_s = max(works, default=None)
        if newest_s is not None and newest_s > max(self._since_s, self._worked_s):
            self._since_s = self._worked_s = newest_s
            self._restarted = False
            self._silent_bucket_s = None
            self.run.board.clear("stall")
            self.run.board.clear("bucket")
        trainer = self._heartbeats.of(TRAINER)
        if trainer is not None and trainer.work_s is not None and trainer.work_s > self._update_s:
            self._update_s = trainer.work_s
            self._told_s, self._stalls = 0.0, 0
            self.run.board.clear("update")
        return self._heartbeats.now_s - self._since_s < self._stall_s

    def _tell_of_missing_update(self) -> None:
        quiet_s = self._heartbeats.now_s - self._update_s
        if quiet_s < max(self._stall_s, 2.0 * self._told_s):
            return
        self._told_s = quiet_s
        text = f"No update for {duration(quiet_s)}: {self._situation()}."
        self.run.board.warn("update", text, "notice")

    def _restart_single(self) -> None:
        now_s = self._heartbeats.now_s
        for child, seen in self._seen():
            quiet_s = now_s - max(seen.since_s, seen.work_s or 0.0, seen.turn_s, self._excused_s)
            if seen.record is not None and not seen.record.waits and quiet_s >= self._stall_s:
                activity = seen.record.activity
                self.run.board.tell(
                    "fault",
                    f"{child.name} ({activity}) made no progress for {duration(quiet_s)} while "
                    "others did; it is restarted.",
                    worker=child.name,
                )
                self._prepare_to_kill([child])

    def _situation(self) -> str:
        waiting = [c.name for c, seen in self._seen() if seen.record and seen.record.waits]
        others = [c.name for c, _ in self._seen() if c.name not in waiting]
        alive = {c.name: f"{c.name}, {self._heartbeats.describe(c.name)}" for c, _ in self._seen()}
        if TRAINER in waiting and others:
            return f"the trainer waits for {'; '.join(alive[name] for name in others)}"
        if others == [TRAINER]:
            activity = self._activity(TRAINER)
            return f"all wait for the trainer ({activity}), {self._heartbeats.describe(TRAINER)}"
        if not others:
            return f"all workers wait for each other: {'; '.join(alive.values())}"
        return "; ".join(f"{alive[name]} ({self._activity(name)})" for name in others)

    def _activity(self, name: str) -> str:
        seen = self._heartbeats.of(name)
        return seen.record.activity if seen is not None and seen.record is not None else "starting"

    def _blamed(self) -> list[Child]:
        """Those that wait for nobody, or are stuck; or all."""
        now_s = self._heartbeats.now_s
        stuck = [
            child
            for child, seen in self._seen()
            if seen.record is None or not seen.record.waits or now_s - seen.turn_s > TURN_S
        ]
        return stuck or [child for child, _ in self._seen()]

    def _prepare_to_kill(self, children: Sequence[Child]) -> None:
        for child in children:
            seen = self._heartbeats.of(child.name)
            if seen is not None and seen.record is not None:
                child.ask_stacks()
            self._stuck.append((child, child.process.pid if child.process is not None else 0))
        self._kill_at_s = self._heartbeats.now_s + STACKS_S

    def _kill_stuck(self) -> None:
        for child, pid in self._stuck:
            if child.process is not None and child.process.pid == pid:  # else it has ended
                child.kill_for("stalled")
        self._stuck = []
        self._since_s = self._heartbeats.now_s

    def _seen(self) -> list[tuple[Child, WorkerHeartbeat]]:
        pairs = ((child, self._heartbeats.of(child.name)) for child in self.run.children)
        return [(child, seen) for child, seen in pairs if seen is not None]


# Replaces workers that no longer run: stopped by a signal, or inside a system call.
#
# Such a process lives, but has no heartbeat and uses no processor time.


FROZEN_S = 30.0
STARTING_S = 120.0
"""Before the first heartbeat it loads libraries, perhaps from a slow disk."""

BUSY_S = 120.0
"""It computes, but one operation never lets Python go on."""

USED_S = 0.05
REMOVAL_S = 10.0
_STATES = {
    psutil.STATUS_STOPPED: "stopped by a signal",
    psutil.STATUS_DISK_SLEEP: "waiting for a disk or network drive",
}


class FrozenWatch(Duty):
    name = "frozen workers"
    check_s = HEARTBEAT_POLL_S

    def __init__(self, run: RunningTraining, heartbeats: HeartbeatMonitor) -> None:
        super().__init__(run)
        self._heartbeats = heartbeats
        self._killed: dict[int, float] = {}
        self._asked: dict[int, float] = {}

    def check(self) -> Outcome | None:
        self._heartbeats.look(self.run.children)
        for child in self.run.children:
            seen = self._heartbeats.of(child.name)
            if seen is None or child.process is None:
                continue
            if seen.pid in self._killed:
                if self._heartbeats.now_s - self._killed[seen.pid] > REMOVAL_S:
                    child.give_up()
            else:
                self._look_at(child, seen)
        return None

    def died(self, child: Child, code: int, exit_reason: WorkerExit | None) -> Outcome | None:
        if child.process is not None:
            self._killed.pop(child.process.pid, None)
            self._asked.pop(child.process.pid, None)
        return None

    def _look_at(self, child: Child, seen: WorkerHeartbeat) -> None:
        silent_s = self._heartbeats.silent_s(seen)
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

    def _replace_busy(self, child: Child, seen: WorkerHeartbeat, silent_s: float) -> None:
        now_s = self._heartbeats.now_s
        if seen.pid not in self._asked and seen.record is not None:
            child.ask_stacks()
            self._asked[seen.pid] = now_s
        if now_s - self._asked.get(seen.pid, -STACKS_S) >= STACKS_S:
            how = "was inside one operation that Python cannot interrupt"
            self._replace(child, seen, f"{how} for {duration(silent_s)}")

    def _replace(self, child: Child, seen: WorkerHeartbeat, what: str) -> None:
        self._killed[seen.pid] = self._heartbeats.now_s
        child.kill_for("frozen")
        self.run.board.tell("fault", f"{child.name} {what}; it is replaced.", worker=child.name)
