"""Runs a training while a schedule of faults happens to it, and audits what comes of it."""

import re
import shutil
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from drcli.base.errors import DrError
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.history import read_history
from drcli.model.lease import read_lease
from drcli.model.model_store import ModelStore
from drcli.records.run_record import Lease
from fault_audit import Audit, audit_twice
from fault_kinds import LOST, Effect, Place, inject
from fault_machine import BUCKET, PREFIX, Machine, Storage, now_s
from fault_schedule import Fault

POLL_S = 0.1
STALL_S = 240.0
"""How long the training may stand still while nothing is wrong; a busy machine starts slowly."""

AUDIT_EVERY = 10
"""After so many faults, the running training is audited too."""

LAST_ITERATIONS = 3
"""Iterations after the last fault."""

SECOND_OWNER_CODES = {3, 9}
"""Exit codes of a start whose prefix belongs to another one."""

RETRY_S = 1.0
"""Pause before a run that has ended is continued, as a service manager makes one."""

HARMLESS = ("MemoryError", "Cannot allocate memory", "alloc_cpu", "can't start new thread")
"""What a traceback may be about, because a fault has taken the memory away."""

ABOUT_THE_BUCKET = re.compile(r"answers? |no server|the server answered|ended (with|by) ")


@dataclass
class Verdict:
    """How a run with faults went.

    Attributes:
        schedule: The faults.
        findings: What was wrong, empty if nothing.
        iterations: Of the model at the end.
        starts: How many times the training was started.
        injected: Faults that happened, by kind.
        skipped: Faults for which there was no place, each with the reason.
        said: Lines of all logs about a bucket that does not answer, and about restarts.
        took_s: Wall time.
        longest_s: Longest time with neither progress nor a fault that lasts.
    """

    schedule: list[Fault]
    findings: list[str] = field(default_factory=list)
    iterations: int = 0
    starts: int = 0
    injected: dict[str, int] = field(default_factory=dict)
    skipped: list[str] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    took_s: float = 0.0
    longest_s: float = 0.0


class Stop(Exception):
    """The run cannot go on; its findings say why."""


class FaultRun:
    """One training, from its start to its goal.

    Args:
        folder: For everything; does not exist yet.
        schedule: The faults, by iteration.
        workers: Simulation workers.
        disk: Whether the bucket may have a disk of its own, for `fill`.
        last_iterations: How many come after the last fault.
        keep: Where to copy the bucket at the end.
        seed: Of the proxies.
        tell: Takes a line about what happens.
    """

    def __init__(
        self,
        folder: Path,
        schedule: Sequence[Fault],
        *,
        workers: int = 2,
        disk: bool = True,
        last_iterations: int = LAST_ITERATIONS,
        keep: Path | None = None,
        seed: int = 0,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._folder = folder
        self._schedule = sorted(schedule, key=lambda fault: fault.after)
        self._goal = max((fault.after for fault in schedule), default=0)
        self._goal += last_iterations
        self._workers = workers
        self._disk = disk
        self._keep = keep
        self._seed = seed
        self._tell = tell
        self._verdict = Verdict(list(schedule))
        self._effects: list[tuple[float, Effect]] = []
        self._codes: set[int] = set()
        self._damaged: set[str] = set()
        self._may_go_back = False
        self._replaces = False
        self._pointed = -1
        self._recorded = 0
        self._term = 0
        self._machines = 0
        self._began_s = self._progressed_s = self._free_s = now_s()

    def run(self) -> Verdict:
        """Run to the goal, or to a finding that prevents it."""
        self._folder.mkdir(parents=True)
        storage = Storage(self._folder / "bucket", disk=self._disk)
        self._place = Place(storage, self._machine(storage, "remote"))
        try:
            self._start()
            for number, fault in enumerate(self._schedule, start=1):
                self._wait(lambda fault=fault: self._recorded >= fault.after)
                self._inject(fault)
                if number % AUDIT_EVERY == 0:
                    self._audit()
            self._wait(lambda: not self._place.machine.running, to_the_end=True)
            self._end_effects()
            self._look_at_others()
            self._check_left_over()
            self._audit(ended=True)
        except Stop:
            pass
        finally:
            self._end_effects()
            for machine in [*self._place.others, self._place.machine]:
                self._check_logs(machine)
                machine.vanish()
            if self._keep is not None:
                shutil.copytree(storage.folder / BUCKET, self._keep)
            storage.close()
            self._verdict.took_s = now_s() - self._began_s
        return self._verdict

    def _machine(self, storage: Storage, cloud: str) -> Machine:
        self._machines += 1
        return Machine(
            self._folder / f"machine-{self._machines}",
            storage,
            cloud="local" if cloud == "local" else "remote",
            iterations=self._goal,
            workers=self._workers,
            seed=self._seed,
        )

    def _start(self) -> None:
        self._verdict.starts += 1
        self._place.machine.start_or_resume()

    def _inject(self, fault: Fault) -> None:
        machine = self._place.machine
        if fault.kind == "gone":
            self._check_logs(machine)
        effect = inject(fault, self._place)
        if effect.skipped:
            self._tell(f"{fault}: skipped, {effect.skipped}")
            self._verdict.skipped.append(f"{fault}: {effect.skipped}")
            return
        self._tell(f"{self._since()} {fault}")
        self._verdict.injected[fault.kind] = self._verdict.injected.get(fault.kind, 0) + 1
        self._codes |= effect.codes
        self._damaged |= effect.damaged
        self._may_go_back |= effect.loses_checkpoint
        self._effects.append((now_s() + effect.for_s, effect))
        if fault.kind == "gone":
            self._place.machine = self._machine(self._place.storage, fault.text("cloud"))
            self._place.storage.ensure_running()
            self._start()
        self._replaces |= effect.replaces and fault.kind != "gone"

    def _wait(self, condition: Callable[[], bool], *, to_the_end: bool = False) -> None:
        """Look after the training until a condition holds."""
        while True:
            self._end_effects(before_s=now_s())
            self._look()
            self._end_winners()
            if not self._place.machine.running:
                ended = self._handle_end()
                if to_the_end and ended:
                    return
            elif condition():
                return
            if self._effects:
                self._free_s = now_s()
            stood_s = self._stood_s()
            self._verdict.longest_s = max(self._verdict.longest_s, stood_s)
            if stood_s > STALL_S:
                self._find(f"No progress for {stood_s:.0f} s.\n{self._tails()}")
                raise Stop
            time.sleep(POLL_S)

    def _stood_s(self) -> float:
        """How long there has been neither progress nor a fault that lasts."""
        return now_s() - max(self._progressed_s, self._free_s)

    def _handle_end(self) -> bool:
        """Continue a run that has ended; whether it has reached its goal instead."""
        machine = self._place.machine
        assert machine.process is not None
        code = machine.process.returncode
        said = machine.said_path.read_text(errors="replace")
        if code == 0:
            if self._recorded < self._goal and len(self._history()) < self._goal:
                self._find(f"The run ended after {self._recorded} iterations.\n{said[-800:]}")
            return True
        if code not in self._codes:
            self._find(f"The run ended with code {code}:\n{said[-1500:]}\n{self._tails()}")
        self._tell(f"{self._since()} the run ended with code {code}")
        if self._stood_s() > STALL_S:
            raise Stop
        self._codes_of_effects()
        self._end_effects()
        if code != -9:  # after a kill, a service manager starts at once
            time.sleep(RETRY_S)
        if self._replaces:
            self._replaces = False
            machine.metadata.notice_s = None
        self._start()
        return False

    def _codes_of_effects(self) -> None:
        """Forget exit codes that only faults of the past explain."""
        self._codes = set()
        for until_s, effect in self._effects:
            if until_s >= now_s():
                self._codes |= effect.codes

    def _end_effects(self, before_s: float = float("inf")) -> None:
        over = [until_s <= before_s or effect.until() for until_s, effect in self._effects]
        due = [pair for pair, ends in zip(self._effects, over, strict=True) if ends]
        self._effects = [pair for pair, ends in zip(self._effects, over, strict=True) if not ends]
        for _, effect in due:
            effect.undo()

    def _look(self) -> None:
        """Check what may never happen, not even for a moment."""
        bucket = self._place.storage.bucket
        pointed = CheckpointStore(ModelStore(bucket, PREFIX)).pointed()
        if pointed is not None and pointed.number != self._pointed:
            if pointed.number < self._pointed and not self._may_go_back:
                self._find(f"The pointer went from checkpoint {self._pointed} to {pointed.number}.")
            if pointed.number < self._pointed:
                self._may_go_back = False  # each damage explains one step back
            self._pointed = pointed.number
            self._progressed_s = now_s()
        with suppress(DrError):
            self._recorded = max(self._recorded, len(self._history()))
        lease = self._lease()
        if lease is not None:
            if lease.term < self._term and keys.lease(PREFIX) not in self._damaged:
                self._find(f"The term of the lease went from {self._term} to {lease.term}.")
            self._term = lease.term

    def _history(self) -> Sequence[object]:
        return read_history(ModelStore(self._place.storage.bucket, PREFIX))

    def _lease(self) -> Lease | None:
        try:
            return read_lease(ModelStore(self._place.storage.bucket, PREFIX))
        except DrError:
            return None

    def _audit(self, *, ended: bool = False) -> None:
        findings = audit_twice(
            lambda: Audit(
                self._place.storage.bucket, PREFIX, self._workers, frozenset(self._damaged), ended
            )
        )
        for finding in findings:
            self._find(finding)
        with suppress(DrError):
            self._verdict.iterations = len(self._history())

    def _end_winners(self) -> None:
        """Take a second owner away that got the model because the first had just ended."""
        for other in list(self._place.others):
            record = other.record()
            if record is None or not record.alive:
                continue
            self._tell(f"{self._since()} the second owner has got the model; its machine is gone")
            self._check_logs(other)
            other.vanish()
            self._place.others.remove(other)
            self._codes |= {*SECOND_OWNER_CODES, LOST}

    def _look_at_others(self) -> None:
        """Second owners must have been refused."""
        for other in self._place.others:
            assert other.process is not None
            with suppress(subprocess.TimeoutExpired):
                other.process.wait(60)
            code = other.process.returncode
            if code not in SECOND_OWNER_CODES:
                said = other.said_path.read_text(errors="replace")
                self._find(f"A second owner ended with code {code}:\n{said[-800:]}")

    def _check_left_over(self) -> None:
        """Nothing but the server and its watcher may run when the training has ended."""
        machine = self._place.machine
        _, left = psutil.wait_procs(machine.processes(), timeout=15)
        for process in left:
            with suppress(psutil.Error):
                self._find(f"Process {process.pid} is left: {' '.join(process.cmdline())}")

    def _check_logs(self, machine: Machine) -> None:
        """No program may end with a traceback."""
        for name, text in machine.logs():
            lines = text.splitlines()
            self._verdict.said += [f"{name}: {x}" for x in lines if ABOUT_THE_BUCKET.search(x)]
            for found in re.finditer(
                r"Traceback \(most recent call last\):\n(?:[ +|].*\n)*.*", text
            ):
                trace = found[0]
                if not any(word in text[found.start() : found.end() + 400] for word in HARMLESS):
                    self._find(f"{name} has a traceback:\n{trace[-1500:]}")

    def _find(self, finding: str) -> None:
        if finding not in self._verdict.findings:
            self._verdict.findings.append(finding)
            self._tell(f"{self._since()} FINDING: {finding}")

    def _tails(self) -> str:
        """The ends of all logs."""
        return "\n".join(f"== {name}\n{text[-1500:]}" for name, text in self._place.machine.logs())

    def _since(self) -> str:
        return f"{now_s() - self._began_s:7.1f} s, iteration {self._recorded}:"
