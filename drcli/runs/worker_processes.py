"""The worker processes of a run, as their supervisor keeps them, and how it sends them away."""

import subprocess
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

TRAINER = "trainer"

SIMULATION_LEAVES_S = 4.0
"""How long the trainer is kept while simulation workers leave: it scores what they evaluated."""


@dataclass
class Child:
    """A worker process and what became of its predecessors."""

    name: str
    module: str
    arguments: list[str]
    gpus: str = ""
    process: subprocess.Popen[bytes] | None = None
    started: float = 0.0
    dismissed: float | None = None
    restarts: int = 0
    quick_deaths: int = 0

    @property
    def running(self) -> bool:
        """Whether the process is alive."""
        return self.process is not None and self.process.poll() is None


def dismiss(children: Sequence[Child], patience_s: float) -> list[Child]:
    """End the workers of a run: those of the simulation first, then the trainer.

    Args:
        children: All of them.
        patience_s: How long they may take to leave; 0 kills them.

    Returns:
        Those that had to be killed.
    """
    began_s = time.monotonic()
    if patience_s > 0.0:
        simulation = [child for child in children if child.name != TRAINER]
        _send_away(simulation)
        _wait(simulation, began_s + min(SIMULATION_LEAVES_S, patience_s))
        _send_away(children)
        _wait(children, began_s + patience_s)
    late = [child for child in children if child.running]
    for child in late:
        if child.process is not None:
            child.process.kill()
            child.process.wait()
    return late


def _send_away(children: Iterable[Child]) -> None:
    for child in children:
        if child.running and child.process is not None:
            child.process.terminate()


def _wait(children: Iterable[Child], deadline_s: float) -> None:
    for child in children:
        if child.process is not None:
            with suppress(subprocess.TimeoutExpired):
                child.process.wait(max(0.0, deadline_s - time.monotonic()))
