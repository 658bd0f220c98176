"""Runs an evaluation in a worker process."""

import logging
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import replace

from drcli.base import notices
from drcli.base.backoff import wait_until
from drcli.base.errors import (
    DrError,
    NotAvailable,
    SettingsError,
    StorageError,
    TrainingFailed,
    WorkerDied,
)
from drcli.base.installation import installation_error
from drcli.base.json_record import RecordError
from drcli.base.log import LogFile, get_logger
from drcli.base.process_identity import started_s
from drcli.base.termination import until_sigterm
from drcli.config.settings import Settings
from drcli.exchange.episode_metrics import REPORT_FILE, EvaluationTrials
from drcli.exchange.evaluation_record import EvaluationRecord
from drcli.exchange.job import Job, WorkerExit
from drcli.exchange.log_places import log_file
from drcli.exchange.policy_source import PolicySource
from drcli.rewards.reward_timeout import exit_of_stuck
from drcli.runs.cloud_watch import sent_to_cloud_watch
from drcli.runs.evaluation_plan import CHECKPOINT, EvaluationPlan, prepare_evaluation
from drcli.runs.evaluation_report import EvaluationReport, trial_reports
from drcli.runs.evaluation_video import filmed
from drcli.runs.failed_start import READY_TIMEOUT_S, failed_start, log_bytes
from drcli.runs.limit_report import with_limit
from drcli.runs.run_logs import empty_logs
from drcli.runs.worker_processes import end_process, start_process
from drcli.store import keys
from drcli.store.connect import open_bucket

EXIT_S = 0.6
LAUNCHED_EXIT_S = 5.0
"""It may already have a worker."""

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
        plan.job, "evaluation", "drcli.runs.evaluation", plan.stamp, *plan.checkpoints
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
            job, "evaluation", "drcli.workers.evaluator", plan.stamp, *plan.checkpoints
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


def _end(plan: EvaluationPlan, process: subprocess.Popen[bytes]) -> None:
    """Results of a killed worker may be incomplete and are deleted."""
    if not end_process(process, EXIT_S):
        with suppress(StorageError):
            bucket = open_bucket(plan.job.config.storage, patience_s=0.0)
            bucket.delete([plan.simtrace, plan.metrics, keys.recording_of(plan.simtrace)])


def until_stopped() -> AbstractContextManager[None]:
    """Let SIGTERM end the block as `Stopped`."""
    return until_sigterm(STOPPED, "Start it again with `dr-evaluate`.")


def _wait_in_background() -> None:
    """`python -m drcli.runs.evaluation STAMP CHECKPOINT [OPPONENT]`."""
    job, (_, stamp, *checkpoints) = Job.received_or_exit(), sys.argv
    notices.warn = lambda text: _log(job, logging.WARNING, text)
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
