"""Makes the job of a start, and the record of its begin."""

import os
import secrets
import socket
import time
from contextlib import suppress
from dataclasses import replace
from datetime import datetime

from drcli.config.settings import Settings
from drcli.exchange.job import Job
from drcli.exchange.run_outcome import RunOutcome
from drcli.exchange.run_record import run_folder
from drcli.exchange.stage import Stage
from drcli.exchange.training_start import TrainingStart
from drcli.workers.ray_extra import has_cluster


def planned_job(
    settings: Settings,
    *,
    seed: int,
    began_at: float,
    until_laps: int | None = None,
    until_lap_time_s: float | None = None,
    max_minutes: float | None = None,
    whole_run: bool = False,
    stages: tuple[Stage, ...] = (),
) -> Job:
    """`began_at`: the very first start; `max_minutes` None: the setting."""
    lives_s = 60.0 * settings.time_to_live_minutes
    config = settings.run
    by_ray = settings.launcher == "ray"
    if by_ray:  # its workers join as those of other machines do
        config = replace(config, train=config.train.replaced(workers=0))
    return Job(
        config=config,
        session=secrets.token_hex(6),
        seed=seed,
        until_laps=until_laps,
        until_lap_time_s=until_lap_time_s,
        max_minutes=max_minutes or settings.train_max_minutes or None,
        folder=run_folder(settings.directory, settings.run_id),
        launcher_pid=os.getpid(),
        whole_run=whole_run,
        ends_at=began_at + lives_s if lives_s else None,
        stages=stages,
        ray_workers=settings.workers if by_ray else 0,
        ray_trainer=by_ray and settings.ray_trainer != "here" and has_cluster(settings),
    )


def first_start(previous: RunOutcome | None, start: TrainingStart | None) -> float:
    if previous is not None:
        return previous.began_at
    if start is not None:
        with suppress(ValueError):
            return datetime.fromisoformat((start.earlier or [start])[0].started_at).timestamp()
    return time.time()


def begun_by(job: Job, began_at: float, goals: str) -> RunOutcome:
    return RunOutcome(job.session, socket.gethostname(), began_at, time.time(), goals=goals)
