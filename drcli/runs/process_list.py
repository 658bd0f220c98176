"""The worker processes of a run on this machine, and how fast one drives."""

from dataclasses import dataclass, field
from pathlib import Path

from drcli.base.process_identity import exists
from drcli.config.run_config import RunConfig
from drcli.exchange.evaluation_record import running_evaluations
from drcli.exchange.log_places import log_file
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.exchange.trace import STEP_S, read_csv
from drcli.runs.worker_processes import TRAINER
from drcli.store import keys
from drcli.store.connect import open_running_bucket
from drcli.store.history import read_history


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


def trainers(directory: Path, run_id: int) -> list[Process]:
    return _workers(directory, run_id, TRAINER)


def simulations(directory: Path, run_id: int) -> list[Process]:
    return _workers(directory, run_id, "sim-")


def evaluations(directory: Path, run_id: int) -> list[Process]:
    return [
        _process(directory, record.prefix, "evaluation", record.worker_pid)
        for record in running_evaluations(directory, run_id)
    ]


def speed_of(process: Process, config: RunConfig) -> SpeedReport:
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
    iteration = history[-1].iteration
    places = keys.training_traces(record.prefix, iteration, number)
    key = next(filter(bucket.exists, places), None)
    if key is None:
        return unknown
    episodes = read_csv(bucket.get(key))
    rows = sum(episode.steps + 1 for episode in episodes)
    seconds = [at for episode in episodes for at in episode.wall_s]
    if not seconds or max(seconds) <= min(seconds):
        return unknown
    # There is one row more than there are pauses between rows.
    steps_per_s = (rows - 1) / (max(seconds) - min(seconds))
    factor = steps_per_s * STEP_S
    return SpeedReport(process.name, process.pid, iteration, rows, steps_per_s, factor)


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
    return Process(name, pid, exists(pid), str(log_file(directory, prefix, name)))
