"""Interrupts a training when the process that started it has ended."""

import os

from drcli.runs.duty import Duty, RunningTraining
from drcli.runs.outcome import Outcome, interrupted

SAVE_S = 55.0


class ParentWatch(Duty):
    """Ray places a training again when its actor has ended, perhaps elsewhere."""

    name = "parent watch"

    def __init__(self) -> None:
        self._ends_with = 0

    def start(self, run: RunningTraining) -> None:
        self._ends_with = run.job.ends_with

    def check(self) -> Outcome | None:
        if self._ends_with in (0, os.getppid()):
            return None
        self._ends_with = 0
        return interrupted(
            "Interrupted: the process that started the training has ended.", SAVE_S, continues=True
        )
