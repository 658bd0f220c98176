"""Describes a run: from the note on this machine and from what lies in the bucket."""

from drcli.base.errors import StorageError
from drcli.base.process_identity import exists
from drcli.config.run_config import RunConfig
from drcli.exchange.run_record import LIVE_STATES, RunRecord, State, run_folder
from drcli.runs.report import CheckpointReport, RunReport, WorkerReport
from drcli.runs.run_logs import log_file
from drcli.store import health, keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, get_json
from drcli.store.connect import open_running_bucket
from drcli.store.history import IterationRecord
from drcli.store.repair import Model, readable_history, readable_scores
from drcli.store.scores import Score


def inspect(config: RunConfig) -> RunReport:
    """Everything there is to say about a run."""
    folder = run_folder(config.directory, config.run_id)
    record = RunRecord.read(folder)
    alive = record is not None and record.alive
    if not alive:
        record = RunRecord.read(folder)  # a supervisor writes how it went just before it leaves
    if record is None:
        return RunReport(
            run_id=config.run_id,
            bucket=config.storage.bucket,
            prefix=config.model.prefix,
            world=config.race().world_name,
            state="none",
        )
    # Which may have been another one at the start.
    bucket = open_running_bucket(record.storage_at_start(config.storage, config.directory))
    history: list[IterationRecord] = []
    best = last = None
    damaged: list[str] = []
    activities: dict[str, str] = {}
    if bucket is not None:
        try:
            model = Model.of(config.model, bucket, record.prefix)
            history, damaged = readable_history(model)
            scores, also = readable_scores(model)
            damaged += also
            if scores is not None:
                best, last = _report(scores.best_checkpoint), _report(scores.last_checkpoint)
            names = [worker.name for worker in record.workers]
            activities = {name: _activity(bucket, record.prefix, name) for name in names}
        except StorageError as error:
            activities = {"trainer": f"the bucket does not answer: {error}"}
    state: State = record.state
    if record.state in LIVE_STATES and not alive:
        state = "lost"
    running = state in LIVE_STATES
    workers = [
        WorkerReport(
            name=worker.name,
            pid=worker.pid,
            alive=running and worker.pid is not None and exists(worker.pid),
            restarts=worker.restarts,
            activity=activities.get(worker.name, "") if running else "",
            log=str(log_file(config.directory, record.prefix, worker.name)),
        )
        for worker in record.workers
    ]
    return RunReport(
        run_id=record.run_id,
        bucket=record.bucket,
        prefix=record.prefix,
        world=record.world,
        state=state,
        message=record.message
        if state != "lost"
        else "The supervisor is gone; its workers have left with it.",
        remedy=record.remedy if state != "lost" else "Continue with `dr-start-training --resume`.",
        exit_code=record.exit_code,
        started_at=record.started_at,
        elapsed_s=history[-1].elapsed_s if history else 0.0,
        pid=record.pid,
        workers=workers,
        history=history,
        best=best,
        last=last,
        warning=health.collapse(history, best.name if best is not None else None) or "",
        damaged=damaged,
    )


def _report(score: Score) -> CheckpointReport:
    return CheckpointReport(score.name, score.avg_eval_metric)


def _activity(bucket: Bucket, prefix: str, name: str) -> str:
    key = keys.status(prefix, name)
    try:
        note = get_json(bucket, key)
    except ObjectMissing:
        return "starting"
    except ObjectDamaged as error:
        return str(error)
    if not isinstance(note, dict) or not isinstance(note.get("activity"), str):
        return f"{bucket.name}/{key} is damaged"
    return str(note["activity"])
