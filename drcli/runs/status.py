"""Looks up the state of a run: in its record on this machine and in the bucket."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from drcli.base.errors import StorageError
from drcli.base.process_identity import exists
from drcli.config.settings import RunConfig
from drcli.exchange.evaluation_record import running_evaluations
from drcli.exchange.iteration import IterationRecord
from drcli.exchange.run_record import LIVE_STATES, RunRecord, State, run_folder
from drcli.exchange.run_state import ActivityRecord
from drcli.exchange.spending import Spending
from drcli.exchange.trace import STEP_S
from drcli.exchange.watch_record import WatchRecord
from drcli.models.model_list import CheckpointEntry
from drcli.runs.run_logs import log_file
from drcli.runs.spending_report import RequestReport, money_left, request_report, time_left_s
from drcli.runs.worker_health import WorkerHealth
from drcli.runs.worker_processes import TRAINER
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, read_record
from drcli.store.connect import open_running_bucket
from drcli.store.history import HistoryReader, collapse, read_history
from drcli.store.last_outcome import read_outcome
from drcli.store.repair import Model, readable_history, readable_scores


@dataclass(frozen=True)
class WorkerReport:
    """One worker process.

    Attributes:
        name: "trainer", "sim-0", "sim-1", ...
        pid: Its process; None before it started.
        alive: Whether that process runs.
        restarts: How often the supervisor has restarted it.
        activity: What it does or waits for, in a few words.
        log: Path of its log file on this machine.
        health: Its progress and memory; null if it does not run.
    """

    name: str
    pid: int | None
    alive: bool
    restarts: int
    activity: str
    log: str
    health: WorkerHealth | None = None


@dataclass(frozen=True)
class RunReport:
    """Everything `dr-status` knows.

    Attributes:
        run_id: DR_RUN_ID.
        bucket: Name of the bucket.
        prefix: Model prefix in the bucket.
        world: DR_WORLD_NAME.
        state: Whether the run is starting or running, or how it ended.
        message: Why it ended.
        remedy: What to do if it failed.
        exit_code: Exit code of the supervisor once it has ended.
        started_at: Unix seconds of the start.
        elapsed_s: Wall time of training so far.
        pid: The supervisor.
        workers: All worker processes.
        history: All finished iterations, oldest first.
        best: The best checkpoint by DR_TRAIN_BEST_MODEL_METRIC.
        last: The newest checkpoint.
        warning: Problem with the learning curve; empty if there is none.
        damaged: A sentence about each damaged object in the bucket. The history and the checkpoints
            are reconstructed then, as far as possible.
        iterations: Finished iterations.
        iterations_left: Until DR_TRAIN_MAX_ITERATIONS; None without that limit.
        time_left_s: Until the time limit; None without one.
        spending: Machine hours and money of all starts; None before the first count.
        money_left: Until DR_MAX_COST, USD; None without that limit.
        requests: Requests to the bucket of the newest start; None before the first count.
        watches: What the watches of the training warn of, a sentence each: memory, disk, stalls.
        priority: DR_PRIORITY of this start, normal or low.
        threads: DR_THREADS of this start; 0 for all cores.
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
    best: CheckpointEntry | None = None
    last: CheckpointEntry | None = None
    warning: str = ""
    damaged: list[str] = field(default_factory=list)
    iterations: int = 0
    iterations_left: int | None = None
    time_left_s: float | None = None
    spending: Spending | None = None
    money_left: float | None = None
    requests: RequestReport | None = None
    watches: list[str] = field(default_factory=list)
    priority: str = "normal"
    threads: int = 0

    @property
    def dead(self) -> list[str]:
        """Workers that should run but do not."""
        if self.state not in LIVE_STATES:
            return []
        return [worker.name for worker in self.workers if worker.pid and not worker.alive]


@dataclass(frozen=True)
class Process:
    """A worker of a running training or evaluation.

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
    """The result of `dr-find-sagemaker` and `dr-find-robomaker`.

    Attributes:
        processes: The workers that run.
    """

    processes: list[Process] = field(default_factory=list)


@dataclass(frozen=True)
class SpeedReport:
    """The newest iteration that a simulation worker has finished.

    Attributes:
        worker: "sim-0", "sim-1", ...
        pid: Its process.
        iteration: Number of the iteration, None before the first.
        steps: Steps that all its cars together drove in it.
        steps_per_s: Steps per second of wall time while it drove.
        real_time_factor: Simulated seconds of all cars together, per second of wall time.
    """

    worker: str
    pid: int
    iteration: int | None = None
    steps: int = 0
    steps_per_s: float | None = None
    real_time_factor: float | None = None


def inspect(config: RunConfig, reader: HistoryReader | None = None) -> RunReport:
    """Look up everything about a run; a `reader` saves time if this is repeated."""
    folder = run_folder(config.directory, config.run_id)
    record = RunRecord.read(folder)
    alive = record is not None and record.alive
    if not alive:
        record = RunRecord.read(folder)  # a supervisor records the outcome just before it exits
    record = record or _record_of_elsewhere(config)
    if record is None:
        return RunReport(
            run_id=config.run_id,
            bucket=config.storage.bucket,
            prefix=config.model.prefix,
            world=config.race().world_name,
            state="none",
        )
    # The bucket of the start: the settings may name another one now.
    bucket = open_running_bucket(record.storage_at_start(config.storage, config.directory))
    history: list[IterationRecord] = []
    best = last = None
    damaged: list[str] = []
    activities: dict[str, str] = {}
    if bucket is not None:
        try:
            model = Model.of(config.model, bucket, record.prefix)
            history, damaged = readable_history(model, reader)
            scores, also = readable_scores(model)
            damaged += also
            if scores is not None:
                best = CheckpointEntry.of(scores.best_checkpoint)
                last = CheckpointEntry.of(scores.last_checkpoint)
            names = [worker.name for worker in record.workers]
            activities = {name: _activity(bucket, record.prefix, name) for name in names}
        except StorageError as error:
            activities = {TRAINER: f"the bucket does not answer: {error}"}
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
            health=WorkerHealth.of(folder, worker.name, worker.pid) if running else None,
        )
        for worker in record.workers
    ]
    spending = Spending.read(folder)
    if spending is not None and spending.session != record.session:
        spending = None  # of an earlier start; this one has not counted yet
    most = config.train.train_max_iterations
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
        pid=record.pid or None,
        workers=workers,
        history=history,
        best=best,
        last=last,
        warning=collapse(history, best.name if best is not None else None) or "",
        damaged=damaged,
        iterations=len(history),
        iterations_left=max(0, most - len(history)) if most > 0 else None,
        time_left_s=time_left_s(spending),
        spending=spending,
        money_left=money_left(spending),
        requests=request_report(folder, record.session, spending),
        watches=WatchRecord.read(folder, record.session).warnings,
        priority=record.priority,
        threads=record.threads,
    )


def _record_of_elsewhere(config: RunConfig) -> RunRecord | None:
    """How the run ended on another machine, as its own record would say; None if it has not."""
    bucket = open_running_bucket(config.storage)
    if bucket is None:
        return None
    try:
        outcome = read_outcome(bucket, config.model.prefix)
    except StorageError:
        return None
    if outcome is None or not outcome.ended:
        return None
    return RunRecord(
        run_id=config.run_id,
        session=outcome.session,
        bucket=bucket.name,
        prefix=config.model.prefix,
        world=config.race().world_name,
        state=outcome.state,
        pid=0,
        pid_started=0.0,
        started_at=outcome.started_at,
        ended_at=outcome.ended_at,
        exit_code=outcome.code,
        message=f"On {outcome.host}: {outcome.message}" if outcome.host else outcome.message,
        remedy=outcome.remedy,
    )


def trainers(directory: Path, run_id: int) -> list[Process]:
    """The trainer of this DR_RUN_ID; empty if no training runs."""
    return _workers(directory, run_id, TRAINER)


def simulations(directory: Path, run_id: int) -> list[Process]:
    """The simulation workers of this DR_RUN_ID, in order; empty if no training runs."""
    return _workers(directory, run_id, "sim-")


def evaluations(directory: Path, run_id: int) -> list[Process]:
    """The workers of the running evaluations of this DR_RUN_ID, oldest first."""
    return [
        _process(directory, record.prefix, "evaluation", record.worker_pid)
        for record in running_evaluations(directory, run_id)
    ]


def speed_of(process: Process, config: RunConfig) -> SpeedReport:
    """Measure how fast a simulation worker of a training drives."""
    unknown = SpeedReport(process.name, process.pid)
    record = RunRecord.read(run_folder(config.directory, config.run_id))
    if record is None:
        return unknown
    bucket = open_running_bucket(record.storage_at_start(config.storage, config.directory))
    if bucket is None:
        return unknown
    history = read_history(bucket, record.prefix)
    if not history:
        return unknown
    number = int(process.name.removeprefix("sim-"))
    workers = sum(worker.name.startswith("sim-") for worker in record.workers)
    iteration = history[-1].iteration
    key = keys.training_trace(record.prefix, iteration, worker=number, workers=workers)
    try:
        rows = bucket.get(key).decode().splitlines()[1:]
    except ObjectMissing:
        return unknown
    seconds = [float(row.rpartition(",")[2]) for row in rows]  # wall time of each step
    if len(seconds) < 2 or seconds[-1] <= seconds[0]:
        return unknown
    # There is one step more than there are pauses between steps.
    driven_s = (seconds[-1] - seconds[0]) * len(seconds) / (len(seconds) - 1)
    steps_per_s = len(seconds) / driven_s
    factor = steps_per_s * STEP_S
    return SpeedReport(process.name, process.pid, iteration, len(seconds), steps_per_s, factor)


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
        _process(directory, record.prefix, worker.name, worker.pid)
        for worker in record.workers
        if worker.name.startswith(kind) and worker.pid is not None
    ]


def _process(directory: Path, prefix: str, name: str, pid: int) -> Process:
    """A worker; its model need not be the one that run.env names now."""
    return Process(name, pid, exists(pid), str(log_file(directory, prefix, name)))
