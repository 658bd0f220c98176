"""Log files of a run: one per process, beside each other on disk and in the bucket."""

from pathlib import Path

from drcli.config import Settings
from drcli.store import keys
from drcli.store.bucket import Bucket


def log_file(settings: Settings, directory: Path, worker: str) -> Path:
    """Where a process writes its log on this machine.

    Simulation logs have a folder of their own, because log-guru stops at any other log beside
    them.

    Args:
        settings: Names the model prefix.
        directory: The racer's working folder.
        worker: "trainer", "supervisor", "sim-0", ...
    """
    return directory / "data" / "logs" / _folder(worker) / settings.model_prefix / f"{worker}.log"


def upload_logs(bucket: Bucket, settings: Settings, directory: Path, workers: list[str]) -> None:
    """Copy the logs below the model prefix."""
    for worker in workers:
        path = log_file(settings, directory, worker)
        if path.exists():
            bucket.put(keys.log(settings.model_prefix, _folder(worker), worker), path.read_bytes())


def _folder(worker: str) -> str:
    return "robomaker" if worker.startswith("sim") else "sagemaker"
