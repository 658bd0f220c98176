"""The worker processes that run now: which, under which number, and where their logs are."""

from dataclasses import dataclass, field
from pathlib import Path

from drcli.base.process_identity import exists
from drcli.exchange.evaluation_record import running_evaluations
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.runs.run_logs import log_file


@dataclass(frozen=True)
class Process:
    """A worker of something that runs.

    Attributes:
        name: "trainer", "sim-0", "sim-1", ... or "evaluation".
        pid: Its process.
        alive: Whether that process lives; its supervisor may be about to replace it.
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
        processes: Those that live.
    """

    processes: list[Process] = field(default_factory=list)


def trainers(directory: Path, run_id: int) -> list[Process]:
    """The trainer of this DR_RUN_ID, where a training runs."""
    return _workers(directory, run_id, "trainer")


def simulations(directory: Path, run_id: int) -> list[Process]:
    """The simulation workers of this DR_RUN_ID, where a training runs, in their order."""
    return _workers(directory, run_id, "sim-")


def evaluations(directory: Path, run_id: int) -> list[Process]:
    """Who drives the evaluations of this DR_RUN_ID that run, oldest first."""
    return [
        Process(
            "evaluation",
            record.worker_pid,
            exists(record.worker_pid),
            _log(directory, record.prefix, "evaluation"),
        )
        for record in running_evaluations(directory, run_id)
    ]


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
    """The log of a worker, of whose model run.env may not speak any more."""
    return str(log_file(directory, prefix, name))
