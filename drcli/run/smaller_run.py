"""Makes a run smaller when memory is short: fewer cars, then workers."""

from collections.abc import Sequence

from drcli.run.duty import RunningTraining
from drcli.run.worker_processes import TRAINER, Child

DIVISORS = (2, 4)


class SmallerRun:
    """What is learned stays valid with each step."""

    def __init__(self) -> None:
        self._steps = 0
        self._leaving: set[str] = set()

    def next_step(self, victim: Child, run: RunningTraining) -> str | None:
        simulation = [c for c in run.children if c.name != TRAINER and not c.excluded]
        if self._steps < len(DIVISORS):
            divisor = DIVISORS[self._steps]
            self._steps += 1
            self._divide(simulation, divisor, victim)
            return (
                f"From now on, each worker drives 1/{divisor} of "
                "its cars at a time, and the same episodes."
            )
        if len(simulation) < 2 or run.job.config.train.train_multi_config:
            return None  # with tracks of their own, no worker may be missing
        last = simulation[-1]
        self._leave_out(last, victim)
        return (
            f"The training goes on without {last.name}: each iteration has fewer episodes until it "
            "is started again with `dr-stop-training` and `dr-start-training --resume`."
        )

    def note_excluded(self, child: Child) -> bool:
        if child.name not in self._leaving:
            return False
        child.excluded = True
        return True

    def _divide(self, simulation: Sequence[Child], divisor: int, victim: Child) -> None:
        for child in simulation:
            child.arguments = [child.arguments[0], str(divisor)]
            if child is not victim and victim.name == TRAINER:
                child.kill_for("memory is short")  # it starts again with fewer cars

    def _leave_out(self, last: Child, victim: Child) -> None:
        self._leaving.add(last.name)
        if last is victim:
            self.note_excluded(last)
        else:
            last.kill_for("memory is short")
