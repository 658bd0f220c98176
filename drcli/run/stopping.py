"""Stops trainings, evaluations and the server of a working folder."""

import os
import signal
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from drcli.base.clock import wait_until
from drcli.base.errors import SettingsError, WorkerDied
from drcli.base.installation import lazy_imports
from drcli.base.processes import is_alive
from drcli.base.report import View
from drcli.bucket.server import server
from drcli.config.run_config import RunConfig, StorageConfig
from drcli.records.run_record import (
    EvaluationRecord,
    RunRecord,
    StopRequest,
    WaitingStart,
    run_folder,
    running_evaluations,
)
from drcli.run.status import RunReport, inspect

with lazy_imports():
    from drcli.run import tensorboard_server

TRAINING_PATIENCE_S = 60.0
"""Workers, an upload of the model and logs."""

KILLED_PATIENCE_S = 10.0
EVALUATION_PATIENCE_S = 15.0

Run = RunRecord | EvaluationRecord


@dataclass(frozen=True)
class Stopped:
    """A run that was stopped."""

    kind: Annotated[
        Literal["training", "evaluation", "wait", "worker", "sweep"],
        "training, evaluation, wait for a start that waited for the end of another one, "
        "worker for `dr-start-worker`, or sweep for `dr-sweep start`.",
    ]
    run_id: Annotated[int, "Its DR_RUN_ID."]
    model: Annotated[str, "Its model, as s3://bucket/prefix."]
    pid: Annotated[int, "Its process, which has ended."]

    def __str__(self) -> str:
        what = {"wait": "wait for the end of the training", "worker": "worker for the training"}
        kind = what.get(self.kind, self.kind)
        return f"Stopped the {kind} of {self.model} (run {self.run_id}, process {self.pid})."


@dataclass(frozen=True)
class StopReport:
    """The result of a stop command."""

    stopped: Annotated[list[Stopped], "Trainings and evaluations, in that order."] = field(
        default_factory=list
    )
    server: Annotated[bool, "Whether the local S3 server was stopped too."] = False
    viewer: Annotated[bool, "Whether the console was stopped too."] = False

    def view(self, *, none: str = "Nothing is running.") -> View:
        return [
            *map(str, self.stopped),
            self.server and "Stopped the local S3 server; objects stay.",
            self.viewer and "Stopped the console.",
            not (self.stopped or self.server or self.viewer) and none,
        ]


def running_trainings(directory: Path) -> list[RunRecord]:
    folders = sorted((directory / "data" / "runs").glob("*/run.json"))
    records = (RunRecord.read(path.parent) for path in folders)
    return [record for record in records if record is not None and record.alive]


def stop(config: RunConfig) -> RunReport:
    """A second call meanwhile kills its workers."""
    record = _alive(config)
    if record is not None:
        _terminate([record], config.directory)
        _wait([record], TRAINING_PATIENCE_S)
    return inspect(config)


def stop_waiting(directory: Path, run_id: int) -> list[Stopped]:
    """End waiting starts, and workers of `dr-start-worker`; WorkerDied if one stays.

    A sweep interrupts its trainings first, so that it can continue them.
    """
    waiting = WaitingStart.all(run_folder(directory, run_id))
    for one in waiting:
        with suppress(ProcessLookupError, PermissionError):
            os.kill(one.pid, signal.SIGTERM)
    wait_until(
        lambda: not any(is_alive(one.pid, one.pid_started) for one in waiting),
        patience_s=TRAINING_PATIENCE_S,
        last_s=0.1,
    )
    _refuse_left(waiting)
    return [
        Stopped(one.kind, run_id, f"s3://{one.bucket}/{one.prefix}", one.pid) for one in waiting
    ]


def is_running(config: RunConfig) -> bool:
    return _alive(config) is not None


def _alive(config: RunConfig) -> RunRecord | None:
    record = RunRecord.read(run_folder(config.directory, config.run_id))
    return record if record is not None and record.alive else None


def stop_the_only_training(directory: Path) -> Stopped | None:
    trainings = running_trainings(directory)
    return _stop(trainings, [], directory)[0] if len(trainings) == 1 else None


def stop_runs(directory: Path) -> list[Stopped]:
    waiting = [
        one
        for folder in sorted((directory / "data" / "runs").glob("*"))
        if folder.name.isdigit()
        for one in stop_waiting(directory, int(folder.name))
    ]
    runs = _stop(running_trainings(directory), running_evaluations(directory), directory)
    return [*runs, *waiting]


def stop_evaluations(directory: Path, run_id: int) -> list[Stopped]:
    return _stop([], running_evaluations(directory, run_id), directory)


def stop_evaluations_of(directory: Path, bucket: str, prefix: str) -> list[Stopped]:
    running = running_evaluations(directory)
    own = [each for each in running if (each.bucket, each.prefix) == (bucket, prefix)]
    return _stop([], own, directory)


def stop_all(directory: Path, load: Callable[[], StorageConfig]) -> StopReport:
    """Nothing else on the machine.

    Raises:
        SettingsError: They are wrong, and no server runs in the default folder.
    """
    stopped = stop_runs(directory)
    tensorboard_server.stop_tensorboard(directory)
    try:
        storage = load()
    except SettingsError:
        # The default folder needs no settings.
        if server.stop_default(directory):
            return StopReport(stopped, True)
        raise
    return StopReport(stopped, server.stop(storage))


def _stop(
    trainings: Sequence[RunRecord], evaluations: Sequence[EvaluationRecord], directory: Path
) -> list[Stopped]:
    # A loop of evaluations has a record of its own besides that of its present round.
    evaluations = [*{record.pid: record for record in evaluations}.values()]
    runs: list[Run] = [*trainings, *evaluations]
    _terminate(runs, directory)
    if not _wait(trainings, TRAINING_PATIENCE_S):
        _terminate(trainings, directory)  # at the second signal a supervisor kills its workers
        _wait(trainings, KILLED_PATIENCE_S)
    _wait(evaluations, EVALUATION_PATIENCE_S)
    _refuse_left(runs)
    return [
        Stopped(kind_of(run), run.run_id, f"s3://{run.bucket}/{run.prefix}", run.pid)
        for run in runs
    ]


def _refuse_left(runs: Sequence[Run | WaitingStart]) -> None:
    left = " ".join(str(run.pid) for run in runs if is_alive(run.pid, run.pid_started))
    if left:
        raise WorkerDied(
            f"Process {left.replace(' ', ', ')} did not exit.",
            remedy=f"End it with `kill -9 {left}`; its workers exit with it.",
        )


def kind_of(run: Run) -> Literal["training", "evaluation"]:
    return "training" if isinstance(run, RunRecord) else "evaluation"


def _terminate(runs: Sequence[Run], directory: Path) -> None:
    for run in runs:
        if is_alive(run.pid, run.pid_started):
            if isinstance(run, RunRecord):
                StopRequest(run.session).write(run_folder(directory, run.run_id))
            with suppress(ProcessLookupError):
                os.kill(run.pid, signal.SIGTERM)


def _wait(runs: Sequence[Run], patience_s: float) -> bool:
    return wait_until(
        lambda: not any(is_alive(run.pid, run.pid_started) for run in runs),
        patience_s=patience_s,
        last_s=0.05,
    )
