"""The worker processes that run now: which, under which number, and where their logs are."""

from dataclasses import dataclass, field
from pathlib import Path

from drcli.base.process_identity import exists
from drcli.config.settings import Settings
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


def trainers(settings: Settings, directory: Path) -> list[Process]:
    """The trainer of this DR_RUN_ID, where a training runs."""
    return _workers(settings, directory, "trainer")


def simulations(settings: Settings, directory: Path) -> list[Process]:
    """The simulation workers of this DR_RUN_ID, where a training runs, in their order."""
    return _workers(settings, directory, "sim-")


def evaluations(settings: Settings, directory: Path) -> list[Process]:
    """Who drives the evaluations of this DR_RUN_ID that run, oldest first."""
    return [
        Process(
            "evaluation",
            record.worker_pid,
            exists(record.worker_pid),
            _log(settings, directory, record.prefix, "evaluation"),
        )
        for record in running_evaluations(directory, settings.run_id)
    ]


def _workers(settings: Settings, directory: Path, kind: str) -> list[Process]:
    record = RunRecord.read(run_folder(settings, directory))
    if record is None or not record.alive:
        return []
    return [
        Process(
            worker.name,
            worker.pid,
            exists(worker.pid),
            _log(settings, directory, record.prefix, worker.name),
        )
        for worker in record.workers
        if worker.name.startswith(kind) and worker.pid is not None
    ]


def _log(settings: Settings, directory: Path, prefix: str, name: str) -> str:
    """The log of a worker, of whose model run.env may not speak any more."""
    return str(log_file(settings.replaced(model_prefix=prefix), directory, name))
