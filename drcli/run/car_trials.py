"""Tries all named cars on the track of a model, in a worker process."""

import os
import secrets
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from math import comb
from pathlib import Path

from drcli.base.errors import ProblemsError, WorkerDied
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.config.track_names import track_problem
from drcli.records.evaluation_task import CarTrial, CarTrials, DrivenCars
from drcli.records.job import Job, WorkerExit
from drcli.records.run_record import log_file
from drcli.run.worker_processes import end_process, start_process

STARTS = 16
RARE = 0.05
CAR = "DR_SIM_CAR"
MODEL = "DR_LOCAL_S3_MODEL_PREFIX"
WORLD = "DR_WORLD_NAME"

_EXIT_S = 2.0
_NAME = "cars"


def settings_of_model(settings: Settings, prefix: str, world: str) -> Settings:
    flags = {MODEL: prefix, WORLD: world}
    return load_settings(settings.directory, flags=flags)


def try_cars(settings: Settings, checkpoint: str) -> CarTrials:
    """Drive the model of the settings on their track with each car.

    Raises:
        WorkerDied: The worker failed.
    """
    track = track_problem(settings.race)
    if track is not None:
        raise ProblemsError([replace(track, severity="error")])
    parent = settings.directory / "data" / "runs"
    parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f"{_NAME}-", dir=parent))
    job = Job(
        config=settings.run,
        session=secrets.token_hex(6),
        seed=0,
        max_minutes=None,
        folder=folder,
        launcher_pid=os.getpid(),
    )
    try:
        return CarTrials(
            settings.world_name,
            found := _run(job, checkpoint),
            best_of(found, settings.sim_car),
            settings.sim_car,
        )
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _run(job: Job, checkpoint: str) -> list[CarTrial]:
    process = start_process(job, _NAME, "drcli.drive.try_cars", checkpoint, str(STARTS))
    try:
        code = process.wait()
    except BaseException:
        end_process(process, _EXIT_S)
        raise
    path = log_file(job.directory, job.config.model.prefix, _NAME)
    words = WorkerExit.read(job.folder, _NAME)
    driven = DrivenCars.read(job.folder)
    if driven is not None:
        return driven.cars
    if words is not None:
        raise WorkerDied(words.message, remedy=words.remedy)
    raise WorkerDied(
        f"The worker that tries the cars ended with exit code {code}.",
        remedy=f"Read its log: {path}.",
    )


def best_of(trials: Sequence[CarTrial], present: str) -> str:
    """The car with the most laps; `present` unless the difference is more than chance."""
    own = next((trial for trial in trials if trial.car == present), None)
    most = max(trials, key=lambda trial: (trial.laps, trial.mean_progress))
    # So many others are compared that one of them would often seem better by chance.
    rare = RARE / max(1, len(trials) - 1)
    if own is None or chance(most.laps, own.laps, own.starts) < rare:
        return most.car
    return present


def chance(more: int, fewer: int, starts: int) -> float:
    """How likely equal cars are to differ at least so much (Fisher's exact test)."""
    both = more + fewer
    ways = (
        comb(starts, laps) * comb(starts, both - laps)
        for laps in range(more, min(starts, both) + 1)
    )
    return sum(ways) / comb(2 * starts, both)
