"""Runs a stand-alone evaluation: one worker process, its trace and metrics, a report."""

import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, ClassVar

from drcli.base import log_files
from drcli.base.atomic_file import read_json
from drcli.base.errors import (
    DrError,
    NotAvailable,
    SettingsError,
    StorageError,
    TrainingFailed,
    WorkerDied,
)
from drcli.base.process_identity import started_s
from drcli.checks.reward_timeout import words_of_stuck
from drcli.config.settings import Settings
from drcli.exchange.evaluation_record import EvaluationRecord
from drcli.exchange.job import Job, LastWords
from drcli.runs.evaluation_plan import EvaluationPlan, prepare_evaluation
from drcli.runs.launching import end_process, start_process
from drcli.runs.report import EvaluationReport, TrialReport
from drcli.runs.run_logs import log_file
from drcli.store import keys
from drcli.store.connect import open_bucket

if TYPE_CHECKING:
    import subprocess

LEAVE_S = 0.6
"""How long the worker may take to leave once its evaluation is to end."""

READY_TIMEOUT_S = 20.0

LAUNCHED_LEAVE_S = 5.0
"""How long an evaluation may take to leave that was not ready in time; it may have a worker."""

_FAILURES: dict[int, type[DrError]] = {
    kind.code: kind for kind in (SettingsError, StorageError, TrainingFailed, NotAvailable)
}
"""What a worker may fail of besides itself, by the code that it leaves."""


class EvaluationStopped(DrError):
    """SIGTERM ended the evaluation, as `dr-stop-evaluation` does."""

    code: ClassVar[int] = 143
    final: ClassVar[bool] = True


def evaluate(
    settings: Settings,
    *,
    clone: bool = False,
    seed: int | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
) -> EvaluationReport:
    """Drive the evaluation that the settings describe and wait for its end.

    Args:
        settings: DR_EVAL_* say how; the model prefix says what.
        clone: Copy the model to `<prefix>-E` first and evaluate the copy.
        seed: What random numbers are derived from.
        on_progress: Told in a few words what happens.

    Raises:
        SettingsError: There is no such model or checkpoint.
        WorkerDied: The evaluation worker failed.
        EvaluationStopped: SIGTERM came.
    """
    with _until_sigterm():
        plan = prepare_evaluation(settings, clone=clone, seed=seed, on_progress=on_progress)
        return run_evaluation(plan)


def run_evaluation(plan: EvaluationPlan) -> EvaluationReport:
    """Drive in a worker process and wait for its end; nothing stays of it but its results.

    Raises:
        SettingsError, StorageError: The worker says so.
        WorkerDied: The worker failed.
    """
    folder = plan.job.folder
    try:
        _run(plan)
        return _report(plan, _results(folder))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def launch_evaluation(plan: EvaluationPlan) -> EvaluationRecord:
    """Start the evaluation as processes that outlive this one.

    Raises:
        WorkerDied: It ended at once, or gave no sign of life.
    """
    process = start_process(
        plan.job, "evaluation", "drcli.runs.evaluation_process", plan.stamp, *plan.checkpoints
    )
    deadline = time.monotonic() + READY_TIMEOUT_S
    while process.poll() is None and time.monotonic() < deadline:
        record = EvaluationRecord.read(plan.job.folder)
        if record is not None:
            return record
        time.sleep(0.02)
    end_process(process, LAUNCHED_LEAVE_S)  # or it would drive after all, unknown to anybody
    shutil.rmtree(plan.job.folder, ignore_errors=True)
    path = log_file(plan.job.directory, plan.job.config.model.prefix, "evaluation")
    raise WorkerDied("The evaluation did not start.", remedy=f"Read the reason in {path}.")


def wait_in_background(job: Job, stamp: str, checkpoints: list[str]) -> None:
    """What the waiting process of an evaluation in the background does."""
    with _until_sigterm():
        run_evaluation(EvaluationPlan(replace(job, launcher_pid=os.getpid()), checkpoints, stamp))


def _results(folder: Path) -> list[list[dict[str, Any]]]:
    """What the worker left: the records of each racer's trials.

    Raises:
        WorkerDied: It left something else.
    """
    found = read_json(folder / "evaluation.json")
    if not isinstance(found, list):
        raise WorkerDied(
            "The evaluation worker left no results.",
            remedy="Run `dr-evaluate` again; `dr-logs evaluation` tells what happened.",
        )
    return found


def _report(plan: EvaluationPlan, records: list[list[dict[str, Any]]]) -> EvaluationReport:
    config = plan.job.config
    own = EvaluationReport(
        prefix=config.model.prefix,
        world=config.race().world_name,
        checkpoint=plan.checkpoints[0],
        trials=_trials(records[0]),
        simtrace=plan.simtrace,
        metrics=plan.metrics,
    )
    if len(plan.checkpoints) == 1:
        return own
    prefix = config.evaluation.eval_opp_s3_model_prefix
    opponent = EvaluationReport(
        prefix=prefix,
        world=own.world,
        checkpoint=plan.checkpoints[1],
        trials=_trials(records[1]),
        simtrace=keys.opponent_trace(prefix),
        metrics=keys.opponent_metrics(config.evaluation.eval_opp_s3_metrics_prefix, plan.stamp),
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


def _run(plan: EvaluationPlan) -> None:
    """Run the worker to its end, its output going to the log."""
    job = plan.job
    path = log_file(job.directory, job.config.model.prefix, "evaluation")
    for part in log_files.older_parts(path):
        part.unlink(missing_ok=True)
    if path.exists():
        os.truncate(path, 0)
    LastWords.forget(job.folder, "evaluation")
    process = start_process(
        job, "evaluation", "drcli.workers.evaluator", plan.stamp, *plan.checkpoints
    )
    try:
        _note(plan, process.pid)
        code = process.wait()
    except BaseException:
        _end(plan, process)
        raise
    if code == 0:
        return
    words = LastWords.find(job.folder, "evaluation") or words_of_stuck(
        code, path, remedy="Train the model on with a corrected reward_function.py."
    )
    if words is None:
        raise WorkerDied(
            f"The evaluation worker ended with exit code {code}.", remedy=f"Read its log: {path}."
        )
    raise _FAILURES.get(words.code, WorkerDied)(words.message, remedy=words.remedy)


def _note(plan: EvaluationPlan, worker_pid: int) -> None:
    """Say on this machine that the evaluation runs."""
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
    ).write(plan.job.folder)


def _end(plan: EvaluationPlan, process: "subprocess.Popen[bytes]") -> None:
    """Send the worker away; where it had to be killed, take back what it may have half written."""
    if not end_process(process, LEAVE_S):
        with suppress(StorageError):
            bucket = open_bucket(plan.job.config.storage, patience_s=0.0)
            bucket.delete([plan.simtrace, plan.metrics])


class _Terminated(BaseException):
    """SIGTERM came. No Exception, so that nothing on the way takes it for a failure to repeat."""


@contextmanager
def _until_sigterm() -> Iterator[None]:
    """Let SIGTERM end what is inside as Ctrl-C would, in good order."""

    def leave(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise _Terminated

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    except _Terminated:
        raise EvaluationStopped(
            "The evaluation was stopped.", remedy="Start it again with `dr-evaluate`."
        ) from None
    finally:
        signal.signal(signal.SIGTERM, before)
