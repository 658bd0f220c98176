"""Ends what was started in a working folder: its trainings, evaluations and local S3 server."""

import os
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from drcli.base.errors import SettingsError, WorkerDied
from drcli.base.process_identity import is_alive
from drcli.config.run_config import StorageConfig
from drcli.exchange.evaluation_record import EvaluationRecord, running_evaluations
from drcli.exchange.run_record import RunRecord
from drcli.store.server import server

TRAINING_PATIENCE_S = 30.0
"""For a checkpoint, metrics and logs; after it workers are killed."""

KILLED_PATIENCE_S = 10.0
EVALUATION_PATIENCE_S = 15.0
_POLL_S = 0.05


@dataclass(frozen=True)
class Stopped:
    """Something that was running.

    Attributes:
        kind: What it was.
        run_id: Its DR_RUN_ID.
        model: Its model, as s3://bucket/prefix.
        pid: Its process, which has ended.
    """

    kind: Literal["training", "evaluation"]
    run_id: int
    model: str
    pid: int


@dataclass(frozen=True)
class StopReport:
    """What was ended.

    Attributes:
        stopped: Trainings and evaluations, in that order.
        server: Whether the local S3 server was ended.
    """

    stopped: list[Stopped] = field(default_factory=list)
    server: bool = False


def running_trainings(directory: Path) -> list[RunRecord]:
    """Trainings of all DR_RUN_IDs that were started in a working folder and run."""
    folders = sorted((directory / "data" / "runs").glob("*/run.json"))
    records = (RunRecord.read(path.parent) for path in folders)
    return [record for record in records if record is not None and record.alive]


def stop_the_only_training(directory: Path) -> Stopped | None:
    """End the training that runs in a working folder; None where there is none, or several.

    Raises:
        WorkerDied: Its process does not leave.
    """
    trainings = running_trainings(directory)
    if len(trainings) != 1:
        return None
    _end_trainings(trainings)
    return _stopped(trainings[0])


def stop_runs(directory: Path) -> list[Stopped]:
    """End every training and evaluation that was started in a working folder.

    Raises:
        WorkerDied: A process does not leave.
    """
    evaluations = running_evaluations(directory)
    trainings = running_trainings(directory)
    _tell(evaluations)
    _end_trainings(trainings)
    _wait(evaluations, EVALUATION_PATIENCE_S)
    _refuse_left(evaluations)
    return [*map(_stopped, trainings), *map(_stopped, evaluations)]


def stop_evaluations(directory: Path, run_id: int) -> list[Stopped]:
    """End the evaluations of one DR_RUN_ID, whichever shell started them.

    Raises:
        WorkerDied: A process does not leave.
    """
    evaluations = running_evaluations(directory, run_id)
    _tell(evaluations)
    _wait(evaluations, EVALUATION_PATIENCE_S)
    _refuse_left(evaluations)
    return [_stopped(record) for record in evaluations]


def stop_all(directory: Path, load: Callable[[], StorageConfig]) -> StopReport:
    """End everything that was started in a working folder, and nothing else on the machine.

    Args:
        directory: The racer's working folder.
        load: Says where the bucket is, from the settings.

    Raises:
        SettingsError: These are wrong, and no server is found where one usually is.
        WorkerDied: A process does not leave.
    """
    stopped = stop_runs(directory)
    try:
        storage = load()
    except SettingsError:
        # Where nearly every server keeps its objects; the settings are needed for another place.
        if server.stop_default(directory):
            return StopReport(stopped, True)
        raise
    return StopReport(stopped, server.stop(storage))


def _end_trainings(trainings: Sequence[RunRecord]) -> None:
    _tell(trainings)
    if not _wait(trainings, TRAINING_PATIENCE_S):
        _tell(trainings)  # the second time a supervisor kills its workers
        _wait(trainings, KILLED_PATIENCE_S)
    _refuse_left(trainings)


def _tell(records: Sequence[RunRecord | EvaluationRecord]) -> None:
    for record in records:
        if is_alive(record.pid, record.pid_started):
            with suppress(ProcessLookupError):
                os.kill(record.pid, signal.SIGTERM)


def _wait(records: Sequence[RunRecord | EvaluationRecord], patience_s: float) -> bool:
    """Whether all of them have ended in time."""
    deadline = time.monotonic() + patience_s
    while any(is_alive(record.pid, record.pid_started) for record in records):
        if time.monotonic() > deadline:
            return False
        time.sleep(_POLL_S)
    return True


def _refuse_left(records: Sequence[RunRecord | EvaluationRecord]) -> None:
    left = [str(record.pid) for record in records if is_alive(record.pid, record.pid_started)]
    if left:
        raise WorkerDied(
            f"Process {', '.join(left)} does not leave.",
            remedy=f"End it with `kill -9 {' '.join(left)}`; its workers leave with it.",
        )


def _stopped(record: RunRecord | EvaluationRecord) -> Stopped:
    kind: Literal["training", "evaluation"] = (
        "training" if isinstance(record, RunRecord) else "evaluation"
    )
    return Stopped(kind, record.run_id, f"s3://{record.bucket}/{record.prefix}", record.pid)
