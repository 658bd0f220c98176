"""Interrupts a training when the process that started it has ended, if its job asks for that."""

import os

from drcli.runs.duty import Duty, RunningTraining
from drcli.runs.outcome import Outcome, interrupted

SAVE_S = 55.0
"""How long saving may take: nobody waits for it."""


class ParentWatch(Duty):
    """Watches the parent process of the supervisor.

    A training that Ray has placed on a node must not go on there when Ray has ended its actor:
    Ray places it again, perhaps elsewhere.
    """

    name = "parent watch"

    def __init__(self) -> None:
        self._ends_with = 0

    def start(self, run: RunningTraining) -> None:
        """Begin, if the job names a process."""
        self._ends_with = run.job.ends_with

    def check(self) -> Outcome | None:
        """Interrupt the training once its parent has ended."""
        if self._ends_with in (0, os.getppid()):
            return None
        self._ends_with = 0
        return interrupted(
            "Interrupted: the process that started the training has ended.", SAVE_S, continues=True
        )
