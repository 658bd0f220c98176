"""Two machines on one model: one takes it over from the other, again and again, at bad moments.

The owner is paused, cut off from the bucket, or wide awake when a second machine finds its lease
expired. Both clocks are wrong by up to ten minutes. So that not every takeover lasts a minute, the
second machine's proxy sets the server's clock ahead; now and then it really waits.
"""

import random
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from drcli.base.errors import DrError
from drcli.model import keys
from drcli.model.history import read_history
from drcli.model.lease import STALE_S, read_lease
from drcli.model.model_store import ModelStore
from fault_audit import Audit, audit_twice
from fault_kinds import LOST
from fault_machine import BUCKET, PREFIX, Machine, Storage, now_s, send

POLL_S = 0.1
PATIENCE_S = 240.0
LONGEST_S = 15.0
"""How long two machines may believe that they own the model."""

WRITTEN_LATE_S = 0.5
"""Until then, a write of the old owner is not late: it was checked before the takeover."""

MOST_LATE = 2
"""How many writes may be late because a pause came between the check of the lease and the write:
at most one for each thread that writes. The new owner overwrites these objects again."""

SHIFTS_S = (-600, -90, -7, 0, 0, 7, 90, 600)
HOWS = ("pause", "pause", "cut off", "awake")
REAL_SHARE = 0.1
"""Share of the takeovers that wait until the lease has really expired."""


@dataclass
class Takeovers:
    """What came of some takeovers.

    Attributes:
        longest_s: Longest time during which two machines owned the model and could write.
        latest_s: Latest write of an old owner after the new one had taken the lease.
        late_writes: Writes of old owners that came more than `WRITTEN_LATE_S` after it.
        codes: Exit codes of the old owners.
    """

    count: int = 0
    longest_s: float = 0.0
    latest_s: float = 0.0
    late_writes: int = 0
    iterations: int = 0
    took_s: float = 0.0
    codes: list[int | None] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)


class _GaveUp(Exception):
    """A machine did not do in time what it should."""


class TakeoverRun:
    """A training that goes from machine to machine.

    Args:
        folder: For everything; does not exist yet.
        seed: Decides what happens.
        takeovers: How many.
        tell: Takes a line about what happens.
    """

    def __init__(
        self,
        folder: Path,
        seed: int,
        takeovers: int,
        *,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._folder = folder
        self._rng = random.Random(seed)
        self._takeovers = takeovers
        self._tell = tell
        self._result = Takeovers()
        self._machines: list[Machine] = []

    def run(self) -> Takeovers:
        """Do all takeovers, then let the last machine reach the goal."""
        began_s = now_s()
        self._folder.mkdir(parents=True)
        self._storage = Storage(self._folder / "bucket", disk=False)
        try:
            owner = self._machine(10_000)
            owner.start_or_resume()
            self._wait(lambda: self._iterations() >= 1, "the first iteration")
            for number in range(1, self._takeovers + 1):
                owner = self._take_over(owner, number)
                self._audit(ended=False)
                self._result.count = number
            self._finish(owner)
        except _GaveUp as error:
            self._find(str(error))
        finally:
            for machine in self._machines:
                for process in machine.processes():
                    send(process.pid, signal.SIGCONT)
                machine.vanish()
            self._storage.close()
        self._result.took_s = now_s() - began_s
        return self._result

    def _machine(self, iterations: int) -> Machine:
        machine = Machine(
            self._folder / f"machine-{len(self._machines) + self._result.count}-{iterations}",
            self._storage,
            cloud="remote",
            iterations=iterations,
            workers=1,
        )
        self._machines.append(machine)
        machine.set_clock(self._rng.choice(SHIFTS_S))
        return machine

    def _take_over(self, owner: Machine, number: int) -> Machine:
        rng = self._rng
        how = rng.choice(HOWS)
        really = how != "awake" and rng.random() < REAL_SHARE
        successor = self._machine(10_000)
        early_s = rng.uniform(0.0, 3.0)
        lift_s = rng.uniform(0.0, 6.0)
        paused_s = rng.choice([0.0, 0.0, rng.uniform(1.0, 12.0)])
        self._tell(
            f"{number}: {how}, {'after a minute' if really else 'at once'}, the owner is back "
            f"{lift_s:.1f} s after it lost the model, the new one is paused for {paused_s:.1f} s"
        )
        time.sleep(early_s)  # so that it comes anywhere in an iteration
        if how == "pause":
            stopped = owner.processes()
            rng.shuffle(stopped)
            for process in stopped:
                send(process.pid, signal.SIGSTOP)
        elif how == "cut off":
            owner.proxy.set(refused=True)
        if really:
            time.sleep(STALE_S + 2.0)
        else:
            successor.proxy.set(server_ahead_s=STALE_S + 30.0)
        if how != "pause":  # it may even be away again for a moment
            owner.set_clock(rng.choice(SHIFTS_S))
        successor.start("--resume")
        self._wait(lambda: _taken_s(successor) is not None, "the takeover", successor)
        taken_s = _taken_s(successor) or 0.0
        successor.proxy.set(server_ahead_s=0.0)
        if paused_s:
            for process in successor.processes():
                send(process.pid, signal.SIGSTOP)
        both_s, back, resumed = 0.0, False, not paused_s
        before_s = now_s()
        while owner.running or owner.processes():
            at_s = now_s()
            if not back and at_s >= taken_s + lift_s:
                back = True
                for process in owner.processes():
                    send(process.pid, signal.SIGCONT)
                owner.proxy.set(refused=False)
            if not resumed and at_s >= taken_s + paused_s:
                resumed = True
                for process in successor.processes():
                    send(process.pid, signal.SIGCONT)
            if (back or how == "awake") and owner.running:
                both_s += at_s - before_s
            before_s = at_s
            if at_s > taken_s + PATIENCE_S:
                raise _GaveUp(f"{number}: the old owner did not end.\n{self._tails(owner)}")
            time.sleep(POLL_S)
        for process in successor.processes():
            send(process.pid, signal.SIGCONT)
        self._judge(number, owner, both_s, taken_s)
        self._wait(
            lambda: self._owner_term() is not None and self._progressed(), "progress", successor
        )
        owner.vanish()
        self._machines.remove(owner)
        return successor

    def _judge(self, number: int, owner: Machine, both_s: float, taken_s: float) -> None:
        result = self._result
        code = owner.process.returncode if owner.process is not None else None
        result.codes.append(code)
        result.longest_s = max(result.longest_s, both_s)
        if both_s > LONGEST_S:
            self._find(f"{number}: two owners for {both_s:.1f} s.")
        if code != LOST:
            said = owner.said_path.read_text(errors="replace")
            self._find(f"{number}: the old owner ended with code {code}:\n{said[-800:]}")
        late = []
        for write in owner.proxy.writes:
            key = write.path.removeprefix(f"{BUCKET}/")
            if write.method != "PUT" or not keys.decides(key) or key == keys.lease(PREFIX):
                continue
            late_s = write.began_s - taken_s
            result.latest_s = max(result.latest_s, late_s)
            if late_s > WRITTEN_LATE_S:
                late.append(f"{key} {late_s:.1f} s")
        result.late_writes += len(late)
        if late:
            self._tell(f"{number}: the old owner wrote too late: {', '.join(late)}")
        if len(late) > MOST_LATE:
            self._find(f"{number}: the old owner wrote too late: {', '.join(late)}.")
        for name, text in owner.logs():
            if "Traceback (most recent call last)" in text:
                place = text.index("Traceback (most recent call last)")
                self._find(f"{number}: {name} has a traceback:\n{text[place : place + 1500]}")
        self._seen = self._iterations()

    def _progressed(self) -> bool:
        return self._iterations() > self._seen

    def _owner_term(self) -> int | None:
        with suppress(DrError):
            lease = read_lease(ModelStore(self._storage.bucket, PREFIX))
            return None if lease is None else lease.term
        return None

    def _finish(self, owner: Machine) -> None:
        send(owner.pid_of("supervisor"), signal.SIGTERM)
        self._wait(lambda: not owner.running, "the end of the last owner")
        last = self._machine(self._iterations() + 3)
        last.start("--resume")
        self._wait(lambda: not last.running, "the goal")
        if last.process is not None and last.process.returncode != 0:
            said = last.said_path.read_text(errors="replace")
            self._find(f"The last run ended with {last.process.returncode}:\n{said[-800:]}")
        self._audit(ended=True)
        _, left = psutil.wait_procs(last.processes(), timeout=15)
        if left:
            self._find(f"Processes are left: {[process.pid for process in left]}.")

    def _audit(self, *, ended: bool) -> None:
        findings = audit_twice(lambda: Audit(self._storage.bucket, PREFIX, 1, ended=ended))
        for finding in findings:
            self._find(finding)
        self._result.iterations = self._iterations()

    def _iterations(self) -> int:
        try:
            return len(read_history(ModelStore(self._storage.bucket, PREFIX)))
        except DrError:
            return 0

    def _wait(
        self, condition: Callable[[], bool], what: str, machine: Machine | None = None
    ) -> None:
        deadline_s = now_s() + PATIENCE_S
        while not condition():
            ended = machine is not None and not machine.running
            if ended or now_s() > deadline_s:
                tails = "" if machine is None else self._tails(machine)
                raise _GaveUp(f"Waited in vain for {what}.\n{tails}")
            time.sleep(POLL_S)

    def _tails(self, machine: Machine) -> str:
        return "\n".join(f"== {name}\n{text[-1500:]}" for name, text in machine.logs())

    def _find(self, finding: str) -> None:
        if finding not in self._result.findings:
            self._result.findings.append(finding)
            self._tell(f"FINDING: {finding}")


def _taken_s(machine: Machine) -> float | None:
    """When a machine first wrote the lease, monotonic seconds; None before."""
    place = f"{BUCKET}/{keys.lease(PREFIX)}"
    return next(
        (write.ended_s for write in list(machine.proxy.writes) if write.path == place), None
    )
