"""Runs a stand-alone evaluation: one worker process, its trace and metrics, a report."""

import json
import os
import secrets
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from drcli.config import Settings
from drcli.errors import SettingsError, WorkerDied
from drcli.job import Job, LastWords
from drcli.runs.logs import log_file
from drcli.runs.parameters import evaluation_parameters
from drcli.runs.report import EvaluationReport, TrialReport
from drcli.runs.training import COMMAND_PATIENCE_S, refuse_unsupported
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing, get_json
from drcli.store.connect import open_bucket

CLONE_SUFFIX = "-E"
"""Appended to the prefix of a model that is copied before it is evaluated."""


def evaluate(
    settings: Settings,
    *,
    clone: bool = False,
    seed: int | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
    directory: Path | None = None,
) -> EvaluationReport:
    """Drive the evaluation that the settings describe and wait for its end.

    Args:
        settings: DR_EVAL_* say how; the model prefix says what.
        clone: Copy the model to `<prefix>-E` first and evaluate the copy.
        seed: What random numbers are derived from.
        on_progress: Told in a few words what happens.
        directory: The racer's working folder; the current one if left out.

    Raises:
        SettingsError: There is no such model or checkpoint.
        WorkerDied: The evaluation worker failed.
    """
    directory = (directory or Path.cwd()).absolute()
    refuse_unsupported(settings, "evaluation")
    bucket = open_bucket(settings, directory, patience_s=COMMAND_PATIENCE_S)
    _check_model(settings, bucket)
    if clone:
        settings = _cloned(settings, bucket)
        on_progress(f"Cloned the model into s3://{bucket.name}/{settings.model_prefix}.")
    checkpoint = _choose(settings, bucket)
    stamp = _free_stamp(settings, bucket)
    on_progress(f"Evaluating {checkpoint} on {settings.world_name} ...")
    bucket.put(
        keys.parameter_file(settings.model_prefix, settings.eval_params_file),
        evaluation_parameters(
            settings,
            keys.folder(settings.model_prefix) + f"evaluation-{stamp}",
            keys.evaluation_metrics(settings.metrics_prefix, stamp),
        ),
    )
    job = Job(
        settings=settings,
        directory=directory,
        session=secrets.token_hex(6),
        seed=seed if seed is not None else settings.train_seed or 0,
        until_laps=None,
        max_minutes=None,
        folder=directory / "data" / "runs" / f"eval-{settings.run_id}",
        launcher_pid=os.getpid(),
    )
    _run(job, checkpoint, stamp)
    records = json.loads((job.folder / "evaluation.json").read_text("utf-8"))["metrics"]
    return EvaluationReport(
        prefix=settings.model_prefix,
        world=settings.world_name,
        checkpoint=checkpoint,
        trials=[
            TrialReport(
                trial=record["trial"],
                progress=record["completion_percentage"],
                lap_s=record["elapsed_time_in_milliseconds"] / 1000.0,
                status=record["episode_status"],
                off_track=record["off_track_count"],
                crashes=record["crash_count"],
                resets=record["reset_count"],
            )
            for record in records
        ],
        simtrace=keys.evaluation_trace(settings.model_prefix, stamp),
        metrics=keys.evaluation_metrics(settings.metrics_prefix, stamp),
    )


def _check_model(settings: Settings, bucket: Bucket) -> None:
    prefix = settings.model_prefix
    needed = (keys.model_metadata(prefix), keys.deepracer_checkpoints(prefix))
    for key in needed:
        if not bucket.exists(key):
            raise SettingsError(
                f"There is no trained model at s3://{bucket.name}/{prefix}: {key} is missing.",
                remedy="Train it with `dr-start-training`, or correct DR_LOCAL_S3_MODEL_PREFIX.",
            )


def _choose(settings: Settings, bucket: Bucket) -> str:
    """The checkpoint DR_EVAL_CHECKPOINT asks for."""
    prefix = settings.model_prefix
    index = get_json(bucket, keys.deepracer_checkpoints(prefix))
    wanted = "best_checkpoint" if settings.eval_checkpoint == "best" else "last_checkpoint"
    entry = index.get(wanted) or index.get("last_checkpoint")
    if not entry:
        raise SettingsError(
            f"s3://{bucket.name}/{prefix} has no checkpoint yet.",
            remedy="Wait for the first iteration; `dr-status` shows how far it is.",
        )
    return str(entry["name"])


def _cloned(settings: Settings, bucket: Bucket) -> Settings:
    """Settings of a copy of the model, which is made here."""
    source, target = settings.model_prefix, settings.model_prefix + CLONE_SUFFIX
    for folder in ("model/", "ip/"):
        for item in bucket.list(keys.folder(source) + folder):
            copy = keys.folder(target) + item.key.removeprefix(keys.folder(source))
            bucket.put(copy, bucket.get(item.key))
    return settings.model_copy(
        update={"model_prefix": target, "metrics_prefix": keys.metrics_prefix(target)}
    )


def _free_stamp(settings: Settings, bucket: Bucket) -> str:
    """A name for this evaluation that no other has: two may start in one second."""
    at = time.time()
    while True:
        stamp = time.strftime("%Y%m%d%H%M%S", time.localtime(at))
        try:
            bucket.get(keys.evaluation_trace(settings.model_prefix, stamp))
        except ObjectMissing:
            return stamp
        at += 1.0


def _run(job: Job, checkpoint: str, stamp: str) -> None:
    """Run the worker to its end, its output going to the log."""
    job.folder.mkdir(parents=True, exist_ok=True)
    path = log_file(job.settings, job.directory, "evaluation")
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "drcli.worker.evaluate", checkpoint, stamp],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=job.to_environment(),
            cwd=job.directory,
            start_new_session=True,
        )
        try:
            code = process.wait()
        except BaseException:
            process.terminate()
            process.wait()
            raise
    if code == 0:
        return
    words = LastWords.find(job.folder, "evaluation")
    if words is not None and words.code == SettingsError.code:
        raise SettingsError(words.message, remedy=words.remedy)
    raise WorkerDied(
        words.message if words else f"The evaluation worker ended with exit code {code}.",
        remedy=f"Read its log: {path}.",
    )
