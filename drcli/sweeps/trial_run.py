"""Runs a training of a sweep as `dr-start-training` would."""

import os
import signal
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from drcli.base.errors import DrError, ProblemsError, StorageError, WorkerDied
from drcli.bucket.bucket import Bucket
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.config.settings_files import EXPERIMENT
from drcli.model.history import HistoryReader
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_outcome
from drcli.records.iteration import IterationRecord
from drcli.records.run_record import RunRecord, run_folder
from drcli.run import training
from drcli.run.plan import StartOptions
from drcli.run.resume_or_start import NothingToDo, prepare_next
from drcli.sweeps.sweep_record import TrialRecord, TrialState

_ALONE = {
    "DR_ON_END": "",  # such a command may switch off the machine
    "DR_CONTINUE_ON_SPOT_INTERRUPTION": "True",  # a paused training goes on
    "DR_LAUNCHER": "local",  # with Ray, all of a training is on one node
}


@dataclass(frozen=True)
class Limits:
    """When a training ends; `goals` are those of a `Job`."""

    minutes: float | None = None
    goals: Mapping[str, float] = field(default_factory=dict)
    threads: int = 0


class NothingLeft(DrError):
    """Nothing is left to train."""


class Run(Protocol):
    """A training of a sweep, wherever it runs."""

    def start(self, limits: Limits) -> None:
        """Start or resume it; raises NothingLeft if nothing is to do."""
        ...

    def record(self) -> RunRecord | None: ...

    @property
    def runs(self) -> bool: ...

    def iterations(self) -> list[IterationRecord]: ...

    def interrupt(self) -> None:
        """Let it save and end, without waiting."""
        ...


class TrialRun:
    """A training of a sweep on this machine."""

    def __init__(
        self,
        directory: Path,
        trial: TrialRecord,
        bucket: Bucket,
        *,
        ends_with_parent: bool = False,
    ) -> None:
        self._directory = directory
        self._name = trial.name
        self._prefix = trial.prefix
        self._folder = run_folder(directory, trial.run_id)
        self._bucket = bucket
        self._history = HistoryReader()
        self._ends_with = os.getpid() if ends_with_parent else 0

    def settings(self, threads: int = 0) -> Settings:
        """Whatever the shell was activated for; raises ProblemsError."""
        flags = {EXPERIMENT: self._name, "DR_LOCAL_S3_MODEL_PREFIX": self._prefix, **_ALONE}
        if threads:
            flags["DR_THREADS"] = str(threads)
        return load_settings(self._directory, flags=flags)

    def start(self, limits: Limits) -> None:
        """As `Run.start`.

        Raises:
            TrainedElsewhere: Another machine trains its model.
            NothingLeft: It has reached its limits, or was stopped for good.
            DrError: It cannot start.
        """
        options = StartOptions(
            max_minutes=limits.minutes,
            goals=limits.goals,
        )
        planned = prepare_next(self.settings(limits.threads), options, wait=False)
        if isinstance(planned, NothingToDo):
            raise NothingLeft(planned.sentence, remedy="")
        job = replace(planned.job, ends_with=self._ends_with)
        training.launch(replace(planned, job=job))

    def record(self) -> RunRecord | None:
        found = RunRecord.read(self._folder)
        return found if found is not None and found.prefix == self._prefix else None

    @property
    def runs(self) -> bool:
        found = self.record()
        return found is not None and found.alive

    def iterations(self) -> list[IterationRecord]:
        return self._history.read(ModelStore(self._bucket, self._prefix))

    def interrupt(self) -> None:
        found = self.record()
        if found is not None and found.alive:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(found.pid, signal.SIGTERM)


@dataclass(frozen=True)
class Ended:
    """How a training has ended.

    Attributes:
        state: "paused" if it can go on.
        may_pass: Whether another start may succeed.
    """

    state: TrialState
    message: str = ""
    remedy: str = ""
    may_pass: bool = False


def how_it_ended(record: RunRecord | None, *, asked: bool) -> Ended:
    if record is None or record.state in ("interrupted", "lost", "starting", "running"):
        if asked or (record is not None and record.state == "interrupted"):
            return Ended("paused")
        return Ended("failed", "Its supervisor was killed.", may_pass=True)
    if record.state in ("finished", "stopped"):
        state: TrialState = "finished" if record.state == "finished" else "stopped"
        return Ended(state, record.message)
    may_pass = record.exit_code in (StorageError.code, WorkerDied.code)
    return Ended("failed", record.message, record.remedy, may_pass)


def refused_start(error: DrError) -> Ended:
    return Ended("failed", _in_short(error), error.remedy, isinstance(error, WorkerDied))


def nothing_to_do(model: ModelStore, sentence: str) -> Ended:
    outcome = read_outcome(model)
    stopped = outcome is not None and outcome.stays_ended
    return Ended("stopped" if stopped else "finished", sentence)


def _in_short(error: DrError) -> str:
    if isinstance(error, ProblemsError):
        return " ".join(str(problem).splitlines()[0] for problem in error.errors)
    return str(error)
