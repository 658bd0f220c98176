"""Runs a stand-alone evaluation: one worker process, its trace and metrics, a report."""

import json
import os
import secrets
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from drcli.config import Settings
from drcli.errors import SettingsError, WorkerDied
from drcli.job import Job, LastWords
from drcli.runs.logs import log_file
from drcli.runs.parameters import evaluation_parameters
from drcli.runs.plan import COMMAND_PATIENCE_S, refuse_unsupported
from drcli.runs.report import EvaluationReport, TrialReport
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
    _check_model(bucket, settings.model_prefix, "DR_LOCAL_S3_MODEL_PREFIX")
    if clone:
        settings = _cloned(settings, bucket)
        on_progress(f"Cloned the model into s3://{bucket.name}/{settings.model_prefix}.")
    checkpoints = [_choose(settings, bucket, settings.model_prefix)]
    if settings.race_type == "HEAD_TO_MODEL":
        rival = settings.eval_opp_s3_model_prefix
        _check_model(bucket, rival, "DR_EVAL_OPP_S3_MODEL_PREFIX")
        checkpoints.append(_choose(settings, bucket, rival))
    stamp = _free_stamp(settings, bucket)
    on_progress(f"Evaluating {' against '.join(checkpoints)} on {settings.world_name} ...")
    bucket.put(
        keys.parameter_file(settings.model_prefix, settings.eval_params_file),
        evaluation_parameters(
            settings,
            keys.folder(settings.model_prefix) + f"evaluation-{stamp}",
            keys.evaluation_metrics(settings.metrics_prefix, stamp),
            keys.opponent_metrics(settings.eval_opp_s3_metrics_prefix, stamp),
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
    _run(job, checkpoints, stamp)
    records = json.loads((job.folder / "evaluation.json").read_text("utf-8"))
    own = EvaluationReport(
        prefix=settings.model_prefix,
        world=settings.world_name,
        checkpoint=checkpoints[0],
        trials=_trials(records[0]),
        simtrace=keys.evaluation_trace(settings.model_prefix, stamp),
        metrics=keys.evaluation_metrics(settings.metrics_prefix, stamp),
    )
    if len(checkpoints) == 1:
        return own
    prefix = settings.eval_opp_s3_model_prefix
    opponent = EvaluationReport(
        prefix=prefix,
        world=settings.world_name,
        checkpoint=checkpoints[1],
        trials=_trials(records[1]),
        simtrace=keys.opponent_trace(prefix),
        metrics=keys.opponent_metrics(settings.eval_opp_s3_metrics_prefix, stamp),
    )
    return replace(own, opponent=opponent)


def _trials(records: list[dict[str, Any]]) -> list[TrialReport]:
    return [
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
    ]


def _check_model(bucket: Bucket, prefix: str, setting: str) -> None:
    needed = (keys.model_metadata(prefix), keys.deepracer_checkpoints(prefix))
    for key in needed:
        if not bucket.exists(key):
            raise SettingsError(
                f"There is no trained model at s3://{bucket.name}/{prefix}: {key} is missing.",
                remedy=f"Train it with `dr-start-training`, or correct {setting}.",
            )


def _choose(settings: Settings, bucket: Bucket, prefix: str) -> str:
    """The checkpoint of a model that DR_EVAL_CHECKPOINT asks for."""
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


def _run(job: Job, checkpoints: list[str], stamp: str) -> None:
    """Run the worker to its end, its output going to the log."""
    job.folder.mkdir(parents=True, exist_ok=True)
    path = log_file(job.settings, job.directory, "evaluation")
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "drcli.worker.evaluate", stamp, *checkpoints],
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
