"""Runs an evaluation in a worker process."""

import logging
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from drcli.base import errors
from drcli.base.clock import wait_until
from drcli.base.early_process import ChildProcess
from drcli.base.errors import (
    DrError,
    NotAvailable,
    SettingsError,
    StorageError,
    TrainingFailed,
    WorkerDied,
)
from drcli.base.installation import installation_error, lazy_imports
from drcli.base.json_record import RecordError
from drcli.base.log import LogFile, get_logger
from drcli.base.processes import started_s, until_sigterm
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import open_bucket
from drcli.config.run_config import RunConfig
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.episode_metrics import REPORT_FILE, EvaluationTrials
from drcli.records.evaluation_task import PolicySource
from drcli.records.job import Job, WorkerExit
from drcli.records.run_record import EvaluationRecord, log_file
from drcli.records.trace import read_rows
from drcli.rewards.source import exit_of_stuck
from drcli.run.evaluation_plan import CHECKPOINT, EvaluationPlan, prepare_evaluation
from drcli.run.evaluation_report import EvaluationReport, TrialReport, trial_reports
from drcli.run.log_sender import sent_to_cloud_watch
from drcli.run.run_logs import empty_logs
from drcli.run.worker_processes import (
    READY_TIMEOUT_S,
    end_process,
    failed_start,
    log_bytes,
    start_process,
)
from drcli.tracks.limit_store import StoredLimit
from drcli.tracks.track_limit import LapRow, LostPlace, limit_of_race, limit_text, lost_places

if TYPE_CHECKING:
    from drcli.view.video.film import View

with lazy_imports():
    from drcli.view.video import make_video, trace_source, video_job

# Films an evaluation when it has ended (DR_EVAL_SAVE_MP4).


_logger = get_logger(__name__)


def filmed(
    plan: EvaluationPlan, report: EvaluationReport, on_progress: Callable[[str], None]
) -> EvaluationReport:
    """A failure is a note: the laps were driven."""
    config = plan.job.config
    if not config.evaluation.eval_save_mp4:
        return report
    bucket = open_bucket(config.storage)
    report = _with_videos(
        plan, bucket, report, config.model.prefix, plan.simtrace, plan.stamp, on_progress
    )
    if report.opponent is None:
        return report
    folder = config.evaluation.eval_opp_model_prefix
    other = _with_videos(
        plan, bucket, report.opponent, folder, report.opponent.simtrace, "", on_progress
    )
    return replace(report, opponent=other, notes=[*report.notes, *other.notes])


def _with_videos(
    plan: EvaluationPlan,
    bucket: "Bucket",
    report: EvaluationReport,
    folder: str,
    simtrace: str,
    stamp: str,
    on_progress: Callable[[str], None],
) -> EvaluationReport:
    # Here, because a supervisor of a training must not load what draws.

    config = plan.job.config
    try:
        with tempfile.TemporaryDirectory(prefix="drcli-video-") as temporary:
            files: dict[View, Path] = {
                view: Path(temporary) / f"{camera}.mp4"
                for view, camera in video_job.CAMERAS.items()
            }
            trace = trace_source.trace_of_key(
                ModelStore(bucket, report.prefix), simtrace, f"evaluation {plan.stamp}", ""
            )
            options = make_video.VideoOptions(
                episode="all", size=config.evaluation.eval_video_size, racer="", color=""
            )
            frames = make_video.frames_of(trace, options, list(files.values()))
            on_progress(f"Filming {frames} frames for {len(files)} videos ...")
            found = video_job.make_video(
                video_job.Defaults.of(config.model, config.race()),
                lambda: bucket,
                trace,
                options,
                list(files.items()),
            )
            put = video_job.put_videos(ModelStore(bucket, folder), stamp, files)
    except (DrError, OSError) as error:
        remedy = getattr(error, "remedy", "")
        note = f"The evaluation has no video: {error} {remedy}".strip()
        _logger.warning("%s", note)
        return replace(report, notes=[*report.notes, note])
    notes = [note for note in found.notes if note not in report.notes]
    return replace(report, videos=put, notes=[*report.notes, *notes])


# How far an evaluation's best lap is from the track's limit, and where it loses time.


def with_limit(config: RunConfig, report: EvaluationReport) -> EvaluationReport:
    reverse = config.evaluation.eval_reverse_direction
    stored = limit_of_race(config.race(), reverse=reverse)
    text = limit_text(report.best_lap_s, stored)
    if stored is None or not text:
        return report
    places: list[LostPlace] = []
    with suppress(StorageError):  # the trace has the places only; the result stands without it
        bucket = open_bucket(config.storage)
        places = places_lost(bucket, report.simtrace, report.trials, stored)
    return replace(report, limit=text, lost=[str(place) for place in places])


def places_lost(
    bucket: Bucket, simtrace: str, trials: Sequence[TrialReport], line: StoredLimit
) -> list[LostPlace]:
    best = min((trial for trial in trials if trial.clean), key=lambda trial: trial.lap_s)
    # The laps of a continuous race begin where the first one did, which alone has its start.
    starts = (best.start_position, trials[0].start_position)
    start = next((start for start in starts if start is not None), None)
    if start is None:
        return []
    rows = read_rows(bucket.get(simtrace)).rows
    lap = [
        LapRow(row.progress, row.closest_waypoint)
        for row in rows
        if row.episode == best.trial - 1 and row.status != "pause"
    ]
    return lost_places(lap, start, line) if len(lap) > 1 else []


EXIT_S = 0.6
LAUNCHED_EXIT_S = 5.0
"""An evaluation that was late may already have a worker."""

STOPPED = "The evaluation was stopped."
_FAILURES: dict[int, type[DrError]] = {
    kind.code: kind for kind in (SettingsError, StorageError, TrainingFailed, NotAvailable)
}


def evaluate(
    settings: Settings,
    *,
    clone: bool = False,
    seed: int | None = None,
    own: PolicySource = CHECKPOINT,
    opponent: PolicySource | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
) -> EvaluationReport:
    """Run the evaluation that the settings describe, and wait for its end.

    With `clone`, a copy at `<prefix>-E` drives. `own` and `opponent` (of HEAD_TO_MODEL) say
    what drives.

    Raises:
        SettingsError: The model or checkpoint does not exist.
        WorkerDied: The worker failed.
        Stopped: SIGTERM came.
    """
    with until_stopped():
        plan = prepare_evaluation(
            settings, clone=clone, seed=seed, own=own, opponent=opponent, on_progress=on_progress
        )
        return run_evaluation(plan, on_progress)


def run_evaluation(
    plan: EvaluationPlan, on_progress: Callable[[str], None] = lambda text: None
) -> EvaluationReport:
    """Drive in a worker process, and remove everything except its results."""
    folder = plan.job.folder
    try:
        _run(plan)
        try:
            driven = EvaluationTrials.decode((folder / REPORT_FILE).read_bytes())
        except (OSError, RecordError) as error:
            raise WorkerDied(
                f"The evaluation worker left no results: {error}.",
                remedy="Read the reason with `dr-logs evaluation`, then run `dr-evaluate` again.",
            ) from error
        report = with_limit(plan.job.config, _report(plan, driven))
        return filmed(plan, report, on_progress)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def launch_evaluation(plan: EvaluationPlan) -> EvaluationRecord:
    """Start processes that outlive this one.

    Raises:
        WorkerDied: It exited at once or was not ready in time.
    """
    path = log_file(plan.job.directory, plan.job.config.model.prefix, "evaluation")
    earlier_bytes = log_bytes(path)
    process = start_process(
        plan.job, "evaluation", "drcli.run.evaluation", plan.stamp, *plan.checkpoints
    )
    record: EvaluationRecord | None = None

    def is_decided() -> bool:
        nonlocal record
        record = EvaluationRecord.read(plan.job.folder)
        return record is not None or process.poll() is not None

    wait_until(is_decided, patience_s=READY_TIMEOUT_S, last_s=0.05)
    if record is not None:
        return record
    code = process.poll()
    end_process(process, LAUNCHED_EXIT_S)  # or it could drive later, and nobody would know
    shutil.rmtree(plan.job.folder, ignore_errors=True)
    raise failed_start("The evaluation", code, path, earlier_bytes)


def _report(plan: EvaluationPlan, driven: EvaluationTrials) -> EvaluationReport:
    config = plan.job.config
    sources = plan.job.sources or [CHECKPOINT] * len(driven.racers)
    reports = [
        EvaluationReport(
            prefix=config.model.prefix,
            world=config.race().world_name,
            checkpoint=checkpoint,
            trials=trial_reports(trials),
            simtrace=plan.simtrace,
            metrics=plan.metrics,
            runtime=source.runtime or "torch",
            file=None if source.file is None else str(source.file),
            sha256=source.sha256 or None,
            average_laps=config.evaluation.eval_average_laps,
            notes=driven.notes,
        )
        for checkpoint, trials, source in zip(plan.checkpoints, driven.racers, sources, strict=True)
    ]
    if len(reports) == 1:
        return reports[0]
    theirs = config.evaluation
    opponent = replace(
        reports[1],
        prefix=theirs.eval_opp_s3_model_prefix,
        simtrace=keys.opponent_trace(theirs.eval_opp_s3_model_prefix),
        metrics=keys.opponent_metrics(theirs.eval_opp_s3_metrics_prefix, plan.stamp),
    )
    return replace(reports[0], opponent=opponent)


def _run(plan: EvaluationPlan) -> None:
    job = plan.job
    path = log_file(job.directory, job.config.model.prefix, "evaluation")
    empty_logs(job.directory, job.config.model.prefix, "evaluation")
    WorkerExit.delete(job.folder, "evaluation")
    with sent_to_cloud_watch(job, ["evaluation"]):
        process = start_process(
            job, "evaluation", "drcli.drive.evaluator", plan.stamp, *plan.checkpoints
        )
        try:
            _write_record(plan, process.pid)
            code = process.wait()
        except BaseException:
            _end(plan, process)
            raise
    if code == 0:
        return
    words = WorkerExit.read(job.folder, "evaluation") or exit_of_stuck(
        code, path, remedy="Train the model on with a corrected reward_function.py."
    )
    if words is None:
        raise installation_error() or WorkerDied(
            f"The evaluation worker ended with exit code {code}.", remedy=f"Read its log: {path}."
        )
    raise failure(words.code, words.message, words.remedy)


def failure(code: int, message: str, remedy: str) -> DrError:
    return _FAILURES.get(code, WorkerDied)(message, remedy=remedy)


def _write_record(plan: EvaluationPlan, worker_pid: int) -> None:
    config = plan.job.config
    EvaluationRecord(
        run_id=config.run_id,
        stamp=plan.stamp,
        bucket=config.storage.bucket,
        prefix=config.model.prefix,
        world=config.race().world_name,
        checkpoint=plan.checkpoints[0],
        pid=os.getpid(),
        pid_started=started_s(os.getpid()) or 0.0,
        worker_pid=worker_pid,
        started_at=time.time(),
        others=[config.evaluation.eval_opp_s3_model_prefix] if plan.checkpoints[1:] else [],
    ).write(plan.job.folder)


def _end(plan: EvaluationPlan, process: ChildProcess) -> None:
    """Results of a killed worker may be incomplete and are deleted."""
    if not end_process(process, EXIT_S):
        with suppress(StorageError):
            bucket = open_bucket(plan.job.config.storage, patience_s=0.0)
            bucket.delete([plan.simtrace, plan.metrics, keys.recording_of(plan.simtrace)])


def until_stopped() -> AbstractContextManager[None]:
    """Let SIGTERM end the block as `Stopped`."""
    return until_sigterm(STOPPED, "Start it again with `dr-evaluate`.")


def _wait_in_background() -> None:
    """`python -m drcli.run.evaluation STAMP CHECKPOINT [OPPONENT]`."""
    job, (_, stamp, *checkpoints) = Job.received_or_exit(), sys.argv
    errors.warn = lambda text: _log(job, logging.WARNING, text)
    try:
        with until_stopped():
            here = replace(job, launcher_pid=os.getpid())
            run_evaluation(EvaluationPlan(here, checkpoints, stamp))
    except DrError as error:
        _log(job, logging.ERROR, f"{error} {error.remedy}")
        raise SystemExit(error.code) from None


def _log(job: Job, level: int, text: str) -> None:
    """Until the worker has ended, it alone writes the log."""
    path = log_file(job.directory, job.config.model.prefix, "evaluation")
    log = LogFile(path, job.config.logs.log_max_mb << 20)
    get_logger(__name__).log(level, "%s", text)
    log.end()


if __name__ == "__main__":
    _wait_in_background()
