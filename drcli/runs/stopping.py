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
from drcli.config.settings import Settings
from drcli.exchange.evaluation_record import EvaluationRecord, running_evaluations
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.runs.status import RunReport, inspect
from drcli.store.connect import stop_default_storage, stop_storage

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


def stop(settings: Settings, *, wait_s: float = 30.0, directory: Path | None = None) -> RunReport:
    """Ask the supervisor to end the training, and wait until it has.

    A second request while it is leaving kills the workers at once.
    """
    directory = (directory or Path.cwd()).absolute()
    record = RunRecord.read(run_folder(settings, directory))
    if record is not None and record.alive:
        os.kill(record.pid, signal.SIGTERM)
        deadline = time.monotonic() + wait_s
        while is_alive(record.pid, record.pid_started) and time.monotonic() < deadline:
            time.sleep(0.05)
    return inspect(settings, directory)


def is_running(settings: Settings, directory: Path) -> bool:
    """Whether a training of this run number is alive on this machine."""
    record = RunRecord.read(run_folder(settings, directory))
    return record is not None and record.alive


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


def stop_all(directory: Path, load: Callable[[], Settings]) -> StopReport:
    """End everything that was started in a working folder, and nothing else on the machine.

    Args:
        directory: The racer's working folder.
        load: Gives the settings, which say where the server keeps its objects.

    Raises:
        SettingsError: They are wrong, and no server is found where one usually is.
        WorkerDied: A process does not leave.
    """
    stopped = stop_runs(directory)
    try:
        settings = load()
    except SettingsError:
        # Where nearly every server keeps its objects; the settings are needed for another place.
        if stop_default_storage(directory):
            return StopReport(stopped, True)
        raise
    return StopReport(stopped, stop_storage(settings, directory))


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
