"""Measures how fast a simulation worker drives, from the trace of its newest iteration."""

from dataclasses import dataclass

from drcli.config.settings import RunConfig
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.exchange.trace import STEP_S
from drcli.runs.status import Process
from drcli.store import keys
from drcli.store.bucket import ObjectMissing
from drcli.store.connect import open_running_bucket
from drcli.store.history import read_history


@dataclass(frozen=True)
class SpeedReport:
    """The newest iteration that a worker has handed in.

    Attributes:
        worker: "sim-0", "sim-1", ...
        pid: Its process.
        iteration: Number of the iteration, None before the first.
        steps: Steps that were driven in it, all cars together.
        steps_per_s: Steps a second of wall time while it drove.
        real_time_factor: Simulated seconds a second of wall time, all cars together.
    """

    worker: str
    pid: int
    iteration: int | None = None
    steps: int = 0
    steps_per_s: float | None = None
    real_time_factor: float | None = None


def speed_of(process: Process, config: RunConfig) -> SpeedReport:
    """Measure a simulation worker of the training of a run.

    Raises:
        StorageError: The bucket cannot be read.
    """
    unknown = SpeedReport(process.name, process.pid)
    record = RunRecord.read(run_folder(config.directory, config.run_id))
    bucket = open_running_bucket(config.storage)
    if record is None or bucket is None:
        return unknown
    history = read_history(bucket, record.prefix)
    if not history:
        return unknown
    number = int(process.name.removeprefix("sim-"))
    workers = sum(worker.name.startswith("sim-") for worker in record.workers)
    iteration = history[-1].iteration
    key = keys.training_trace(record.prefix, iteration, worker=number, workers=workers)
    try:
        seconds = _wall_clock_s(bucket.get(key).decode())
    except ObjectMissing:
        return unknown
    if len(seconds) < 2 or seconds[-1] <= seconds[0]:
        return unknown
    # The first row's own share of the time lies before it.
    driven_s = (seconds[-1] - seconds[0]) * len(seconds) / (len(seconds) - 1)
    steps_per_s = len(seconds) / driven_s
    return SpeedReport(
        process.name,
        process.pid,
        iteration,
        len(seconds),
        steps_per_s,
        steps_per_s * STEP_S,
    )


def _wall_clock_s(trace: str) -> list[float]:
    """The last column of a simtrace: Unix seconds at each step."""
    return [float(row.rpartition(",")[2]) for row in trace.splitlines()[1:]]
