"""Starts, watches and interrupts one training of a sweep, as `dr-start-training` would."""

import os
import signal
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.config.settings_files import EXPERIMENT
from drcli.exchange.iteration import IterationRecord
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.exchange.sweep_record import TrialRecord
from drcli.runs import training
from drcli.runs.plan import StartOptions
from drcli.runs.resume_or_start import NothingToDo, prepare_next
from drcli.store.bucket import Bucket
from drcli.store.history import HistoryReader

_ALONE = {
    "DR_ON_END": "",  # such a command may switch off the machine
    "DR_CONTINUE_ON_SPOT_INTERRUPTION": "True",  # a paused training goes on
}
"""Settings of a training that is one of several on this machine."""


@dataclass(frozen=True)
class Limits:
    """When a training ends by itself.

    Attributes:
        minutes: Of training.
        laps: Evaluation laps to be completed.
        lap_time_s: How long each of them may take, simulated seconds.
        threads: Cores that it may use; 0 for those of its settings.
    """

    minutes: float | None = None
    laps: int | None = None
    lap_time_s: float | None = None
    threads: int = 0


class Run(Protocol):
    """A training of a sweep, wherever it runs."""

    def start(self, limits: Limits) -> str:
        """Start it, or resume it; says why if there is nothing to do."""
        ...

    def record(self) -> RunRecord | None:
        """Its newest start; None without one."""
        ...

    @property
    def runs(self) -> bool:
        """Whether it runs."""
        ...

    def iterations(self) -> list[IterationRecord]:
        """Its iterations so far, oldest first."""
        ...

    def interrupt(self) -> None:
        """Let it save its checkpoint and end, without waiting; the next start resumes it."""
        ...


class TrialRun:
    """A training of a sweep on this machine.

    Args:
        directory: The working folder.
        trial: The training.
        bucket: Where its model is.
    """

    def __init__(self, directory: Path, trial: TrialRecord, bucket: Bucket) -> None:
        self._directory = directory
        self._name = trial.name
        self._prefix = trial.prefix
        self._folder = run_folder(directory, trial.run_id)
        self._bucket = bucket
        self._history = HistoryReader()

    def settings(self, threads: int = 0) -> Settings:
        """Its settings: those of its experiment, whatever the shell was activated for.

        Raises:
            ProblemsError: Something is wrong.
        """
        flags = {EXPERIMENT: self._name, "DR_LOCAL_S3_MODEL_PREFIX": self._prefix, **_ALONE}
        if threads:
            flags["DR_THREADS"] = str(threads)
        return load_settings(self._directory, flags=flags)

    def start(self, limits: Limits) -> str:
        """Start it, or resume it.

        Returns:
            Why there is nothing to do; empty if it runs now.

        Raises:
            TrainedElsewhere: Another machine trains its model.
            DrError: It cannot start, with the reason.
        """
        options = StartOptions(
            max_minutes=limits.minutes,
            until_laps=limits.laps,
            until_lap_time_s=limits.lap_time_s,
        )
        planned = prepare_next(self.settings(limits.threads), options, wait=False)
        if isinstance(planned, NothingToDo):
            return planned.sentence
        training.launch(planned)
        return ""

    def record(self) -> RunRecord | None:
        """Its newest start on this machine; None without one of this model."""
        found = RunRecord.read(self._folder)
        return found if found is not None and found.prefix == self._prefix else None

    @property
    def runs(self) -> bool:
        """Whether it runs on this machine."""
        found = self.record()
        return found is not None and found.alive

    def iterations(self) -> list[IterationRecord]:
        """Its iterations so far, oldest first."""
        return self._history.read(self._bucket, self._prefix)

    def interrupt(self) -> None:
        """Let it save its checkpoint and end, without waiting; the next start resumes it."""
        found = self.record()
        if found is not None and found.alive:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(found.pid, signal.SIGTERM)
