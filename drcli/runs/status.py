"""What is known of a run: from its record on this machine and from the bucket."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from drcli.base.errors import StorageError
from drcli.base.process_identity import exists
from drcli.config.settings import RunConfig
from drcli.exchange.evaluation_record import running_evaluations
from drcli.exchange.iteration import IterationRecord
from drcli.exchange.run_record import LIVE_STATES, RunRecord, State, run_folder
from drcli.exchange.scores import Score
from drcli.exchange.worker_state import ActivityRecord
from drcli.runs.run_logs import log_file
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, read_record
from drcli.store.connect import open_running_bucket
from drcli.store.history import collapse
from drcli.store.repair import Model, readable_history, readable_scores


@dataclass(frozen=True)
class WorkerReport:
    """One worker process.

    Attributes:
        name: "trainer", "sim-0", "sim-1", ...
        pid: Its process, or None before it started.
        alive: Whether that process runs.
        restarts: How often the supervisor has restarted it.
        activity: What it is doing or waiting for, in a few words.
        log: Path of its log file on this machine.
    """

    name: str
    pid: int | None
    alive: bool
    restarts: int
    activity: str
    log: str


@dataclass(frozen=True)
class CheckpointReport:
    """A checkpoint that a user may want.

    Attributes:
        name: Such as "12_Step-7824.ckpt".
        metric: Average score of its evaluation episodes, or None before an evaluation.
    """

    name: str
    metric: float | None


@dataclass(frozen=True)
class RunReport:
    """Everything `dr-status` knows.

    Attributes:
        run_id: DR_RUN_ID.
        bucket: Name of the bucket.
        prefix: Model prefix in the bucket.
        world: DR_WORLD_NAME.
        state: Whether the run is starting, running or how it ended.
        message: Why it ended.
        remedy: What to do about it, when it failed.
        exit_code: Exit code of the supervisor once it has ended.
        started_at: Unix seconds of the start.
        elapsed_s: Wall time of training so far.
        pid: The supervisor.
        workers: All worker processes.
        history: All iterations learned, oldest first.
        best: The best checkpoint by DR_TRAIN_BEST_MODEL_METRIC.
        last: The newest checkpoint.
        warning: What is wrong with the learning curve; empty when nothing is.
        damaged: What is damaged in the bucket, a sentence each. The curve and the checkpoints are
            reconstructed then, as far as possible.
    """

    run_id: int
    bucket: str
    prefix: str
    world: str
    state: State
    message: str = ""
    remedy: str = ""
    exit_code: int | None = None
    started_at: float | None = None
    elapsed_s: float = 0.0
    pid: int | None = None
    workers: list[WorkerReport] = field(default_factory=list)
    history: list[IterationRecord] = field(default_factory=list)
    best: CheckpointReport | None = None
    last: CheckpointReport | None = None
    warning: str = ""
    damaged: list[str] = field(default_factory=list)

    @property
    def dead(self) -> list[str]:
        """Workers that should run but do not."""
        if self.state not in ("running", "starting"):
            return []
        return [worker.name for worker in self.workers if worker.pid and not worker.alive]


@dataclass(frozen=True)
class Process:
    """A worker of a training or evaluation that runs.

    Attributes:
        name: "trainer", "sim-0", "sim-1", ... or "evaluation".
        pid: Its process.
        alive: Whether that process runs; its supervisor may be about to restart it.
        log: Path of its log file.
    """

    name: str
    pid: int
    alive: bool
    log: str


@dataclass(frozen=True)
class ProcessReport:
    """What `dr-find-sagemaker` and `dr-find-robomaker` found.

    Attributes:
        processes: Those that run.
    """

    processes: list[Process] = field(default_factory=list)


def inspect(config: RunConfig) -> RunReport:
    """Everything that is known of a run."""
    folder = run_folder(config.directory, config.run_id)
    record = RunRecord.read(folder)
    alive = record is not None and record.alive
    if not alive:
        record = RunRecord.read(folder)  # a supervisor records the outcome just before it exits
    if record is None:
        return RunReport(
            run_id=config.run_id,
            bucket=config.storage.bucket,
            prefix=config.model.prefix,
            world=config.race().world_name,
            state="none",
        )
    # The bucket at the start; the settings may name another one now.
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
    if record.state in LIVE_STATES and not alive:
        record = replace(
            record,
            state="lost",
            message="The supervisor died without giving a reason; its workers exited with it.",
            remedy="Continue with `dr-start-training --resume`.",
        )
    running = record.state in LIVE_STATES
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
        state=record.state,
        message=record.message,
        remedy=record.remedy,
        exit_code=record.exit_code,
        started_at=record.started_at,
        elapsed_s=history[-1].elapsed_s if history else 0.0,
        pid=record.pid,
        workers=workers,
        history=history,
        best=best,
        last=last,
        warning=collapse(history, best.name if best is not None else None) or "",
        damaged=damaged,
    )


def trainers(directory: Path, run_id: int) -> list[Process]:
    """The trainer of this DR_RUN_ID; empty where no training runs."""
    return _workers(directory, run_id, "trainer")


def simulations(directory: Path, run_id: int) -> list[Process]:
    """The simulation workers of this DR_RUN_ID, in order; empty where no training runs."""
    return _workers(directory, run_id, "sim-")


def evaluations(directory: Path, run_id: int) -> list[Process]:
    """The workers of the evaluations of this DR_RUN_ID that run, oldest first."""
    return [
        Process(
            "evaluation",
            record.worker_pid,
            exists(record.worker_pid),
            _log(directory, record.prefix, "evaluation"),
        )
        for record in running_evaluations(directory, run_id)
    ]


def _report(score: Score) -> CheckpointReport:
    return CheckpointReport(score.name, score.avg_eval_metric)


def _activity(bucket: Bucket, prefix: str, name: str) -> str:
    key = keys.status(prefix, name)
    try:
        return read_record(bucket, key, ActivityRecord.decode, "It is written again.").activity
    except ObjectMissing:
        return "starting"
    except ObjectDamaged as error:
        return str(error)


def _workers(directory: Path, run_id: int, kind: str) -> list[Process]:
    record = RunRecord.read(run_folder(directory, run_id))
    if record is None or not record.alive:
        return []
    return [
        Process(
            worker.name,
            worker.pid,
            exists(worker.pid),
            _log(directory, record.prefix, worker.name),
        )
        for worker in record.workers
        if worker.name.startswith(kind) and worker.pid is not None
    ]


def _log(directory: Path, prefix: str, name: str) -> str:
    """The log of a worker. Its model need not be the one that run.env names now."""
    return str(log_file(directory, prefix, name))
