"""A training of a sweep on a node of a cluster, up to its next check.

Free of Ray, for tests.
"""

import os
import re
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from drcli.base.errors import BudgetUsedUp, DrError, StorageError, TrainedElsewhere
from drcli.base.files import rewrite
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import open_bucket
from drcli.config import secret_environment
from drcli.config.loading import load_settings
from drcli.config.settings_files import EXPERIMENT
from drcli.model import keys
from drcli.model.files.curriculum_file import merged_hyperparameters
from drcli.model.lease import STALE_S
from drcli.model.model_store import ModelStore
from drcli.run.take_model import LONG_LOOK_S
from drcli.sweeps.stored_sweep import copy_of
from drcli.sweeps.sweep_file import Budget, EarlyStopping
from drcli.sweeps.sweep_record import Metric, TrialRecord, TrialState
from drcli.sweeps.trial_files import settings_of_model
from drcli.sweeps.trial_run import (
    Ended,
    Limits,
    Run,
    TrialRun,
    how_it_ended,
    nothing_to_do,
    refused_start,
)
from drcli.sweeps.trial_score import amount_of, number_of, score_of, share_at, until

STEP_S = 2.0
"""Ray can end a training only between steps."""

LOOK_S = 0.5
MILLION = 1_000_000
"""The whole budget, in ASHA's whole numbers."""

MOST_STARTS = 3
"""For failures that may pass."""

END_S = 60.0
FINISH_S = 20.0
"""Until a training with a used-up budget ends by itself."""

ELSEWHERE_S = STALE_S + 60.0
"""For taking over when a node may be gone."""


@dataclass(frozen=True)
class TrialTask:
    """What a node has to know of a training.

    Attributes:
        levels: Amounts of comparisons; the last is the budget.
        compared: Checks that are over.
        directory: On `host`.
        files: Contents by relative path, for other machines.
        environment: DR_ settings of the command.
        secrets: Access keys of the bucket.
    """

    trial: TrialRecord
    budget: Budget
    stopping: EarlyStopping
    levels: tuple[float, ...]
    compared: int
    metric: Metric
    limits: Limits
    directory: Path
    host: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=dict)
    secrets: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class TrialStep:
    """How far a training is.

    Attributes:
        state: "paused" if the sweep was interrupted.
        done: Whether nothing more is to do here.
        millionths: Share of the budget of the last check; at least that, after rounding.
        score: At a check just reached; larger is better.
        trial: Fields of its record that copying has changed.
        code: Exit code of its failure, or 0.
    """

    name: str
    state: TrialState
    done: bool
    amount: float
    checks: int
    millionths: int
    score: float
    message: str
    remedy: str
    trial: Mapping[str, Any]
    code: int = 0


class NodeTrial:
    """A training on this node."""

    def __init__(
        self,
        task: TrialTask,
        directory: Path,
        bucket: Bucket,
        *,
        open_run: Callable[[TrialRecord, Mapping[str, str]], Run] | None = None,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self._task = task
        self._directory = directory
        self._bucket = bucket
        self._open_run = open_run or self._local_run
        self._pause = pause
        self._checks = task.compared
        self._starts = 0
        self._code = 0
        self._started = False
        self._elsewhere_since: float | None = None
        self._open(task.trial)

    def step(self, stopping: Callable[[], bool] = lambda: False) -> TrialStep:
        """Train for a moment, or until the next check.

        Raises:
            StorageError: The bucket does not answer.
        """
        ends_s = time.monotonic() + STEP_S
        while True:
            if stopping():
                self.end()
                return self._step(Ended("paused"), done=True)
            amount = self._amount()
            if amount >= self._task.levels[self._checks]:
                self._checks += 1
                if self._checks < len(self._task.levels):
                    return self._at_check()
                self._wait(FINISH_S)
                self.end()
                return self._step(self._used_up(), done=True)
            ended = self._keep_going()
            if ended is not None:
                return self._step(ended, done=True)
            if time.monotonic() >= ends_s:
                return self._step(Ended("running"), done=False)
            self._pause(LOOK_S)

    def end(self) -> None:
        self._run.interrupt()
        self._wait(END_S)

    def state(self) -> dict[str, Any]:
        trial = self._trial
        return {
            "name": trial.name,
            "changed": _changed(trial),
            "checks": self._checks,
            "amount": self._amount(),
        }

    def restore(
        self, state: Mapping[str, Any], number: int, hyperparameters: Mapping[str, float]
    ) -> None:
        """Go on, or copy another training as copy `number` of the sweep."""
        self._checks = state["checks"]
        trial = self._task.trial
        if state["name"] == trial.name:
            self._open(replace(trial, **state["changed"]))
            return
        self.end()
        self._started = False
        self._open(
            replace(
                trial,
                prefix=copy_of(trial, number),
                source=state["changed"]["prefix"],
                earlier=state["amount"],
                hyperparameters=dict(hyperparameters),
            )
        )

    def _open(self, trial: TrialRecord) -> None:
        self._trial = trial
        if trial.hyperparameters:
            path = self._directory / "experiments" / trial.name / "custom_files"
            path /= keys.HYPERPARAMETERS_FILE
            rewrite(path, merged_hyperparameters(path.read_bytes(), trial.hyperparameters))
        changes = settings_of_model(
            self._task.budget, trial.prefix, used=trial.earlier, source=trial.source
        )
        self._run = self._open_run(trial, changes)

    def _local_run(self, trial: TrialRecord, changes: Mapping[str, str]) -> Run:
        return TrialRun(
            self._directory, trial, self._bucket, changes=changes, ends_with_parent=True
        )

    def _keep_going(self) -> Ended | None:
        trial, run = self._task.trial, self._run
        if trial.is_over:  # only its checks are told again
            return Ended(trial.state, trial.message, trial.remedy)
        if run.runs:
            self._started = True
            return None
        if self._started:
            ended = how_it_ended(run.record(), asked=False)
            if ended.state in ("finished", "stopped"):
                return ended if self._amount() < self._task.levels[self._checks] else None
            self._started = False
            return self._failed(ended) if ended.state == "failed" else None
        return self._start()

    def _start(self) -> Ended | None:
        limits, budget = self._task.limits, self._task.budget
        if budget.resource == "minutes":
            limits = replace(limits, minutes=budget.most - self._trial.earlier)
        try:
            over = self._run.start(limits)
        except TrainedElsewhere as error:
            if self._elsewhere_since is None:
                self._elsewhere_since = time.monotonic()
            if time.monotonic() > self._elsewhere_since + ELSEWHERE_S:
                return refused_start(error)
            self._pause(LONG_LOOK_S)
            return None
        except StorageError:
            raise
        except DrError as error:
            self._code = error.code if isinstance(error, BudgetUsedUp) else 0
            return self._failed(refused_start(error))
        self._elsewhere_since = None
        if over:
            return nothing_to_do(ModelStore(self._bucket, self._trial.prefix), over)
        self._started = True
        return None

    def _failed(self, ended: Ended) -> Ended | None:
        self._starts += 1
        return None if ended.may_pass and self._starts <= MOST_STARTS else ended

    def _wait(self, seconds: float) -> None:
        ends_s = time.monotonic() + seconds
        while self._run.runs and time.monotonic() < ends_s:
            self._pause(LOOK_S)

    def _amount(self) -> float:
        records = self._run.iterations()
        return self._trial.earlier + amount_of(records, self._task.budget.resource)

    def _used_up(self) -> Ended:
        if self._task.trial.is_over:
            return Ended(self._task.trial.state, self._task.trial.message)
        ended = how_it_ended(self._run.record(), asked=True)
        known = ended.state in ("finished", "stopped")
        return ended if known else Ended("finished", "Its budget is used up.")

    def _at_check(self) -> TrialStep:
        return self._step(Ended("running"), done=False, at=self._task.levels[self._checks - 1])

    def _step(self, ended: Ended, *, done: bool, at: float | None = None) -> TrialStep:
        task = self._task
        records = self._run.iterations()
        resource = task.budget.resource
        within = records if at is None else until(records, resource, at - self._trial.earlier)
        level = task.levels[self._checks - 1] if self._checks else 0.0
        share = share_at(task.budget, task.stopping, level)
        return TrialStep(
            name=self._trial.name,
            state=ended.state,
            done=done,
            amount=self._amount(),
            checks=self._checks,
            millionths=1 + round(MILLION * share) if level else 0,
            score=number_of(score_of(within, task.metric), task.metric),
            message=ended.message,
            remedy=ended.remedy,
            trial=_changed(self._trial),
            code=self._code,
        )


def open_on_node(task: TrialTask) -> NodeTrial:
    """Prepare this node.

    Raises:
        SettingsError: Settings are wrong here, or the folder cannot be written.
        StorageError: The bucket does not answer.
    """
    for name in [each for each in os.environ if each.startswith("DR_")]:
        del os.environ[name]
    os.environ.update(task.environment)
    secret_environment.keep(task.secrets)
    folder = folder_on_node(task, Path.home() / ".cache" / "drcli" / "ray")
    settings = load_settings(folder, flags={EXPERIMENT: task.trial.name})
    return NodeTrial(task, folder, open_bucket(settings.storage))


def folder_on_node(task: TrialTask, beside: Path) -> Path:
    """The sweep's own folder on its machine, elsewhere a copy."""
    if task.host == socket.gethostname() and task.directory.is_dir():
        return task.directory
    folder = beside / re.sub(r"\W+", "-", f"{task.host}{task.directory}")
    for name, data in task.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        rewrite(path, data)
    return folder


def files_for_nodes(directory: Path, name: str) -> dict[str, bytes]:
    places = [
        *directory.glob("*.env"),
        *(directory / "experiments" / name).rglob("*"),
        *(directory / "tracks").rglob("*"),
    ]
    return {
        str(path.relative_to(directory)): path.read_bytes()
        for path in sorted(places)
        if path.is_file()
    }


def _changed(trial: TrialRecord) -> dict[str, Any]:
    return {
        "prefix": trial.prefix,
        "source": trial.source,
        "earlier": trial.earlier,
        "hyperparameters": dict(trial.hyperparameters),
    }
