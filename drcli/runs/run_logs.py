"""Log files of a run: one per process, beside each other on disk and in the bucket."""

from pathlib import Path

from drcli.base import log_files
from drcli.base.errors import SettingsError

_FOLDERS = ("robomaker", "sagemaker")


def log_file(directory: Path, prefix: str, worker: str) -> Path:
    """Where a process writes its log on this machine.

    Simulation logs have a folder of their own, because log-guru stops at any other log beside
    them.

    Args:
        directory: The racer's working folder.
        prefix: The model.
        worker: "trainer", "supervisor", "sim-0", ...
    """
    return _folder(directory, prefix, log_kind(worker)) / f"{worker}.log"


def log_kind(worker: str) -> str:
    """The folder in which the log of a process lies, on disk and in the bucket."""
    return _FOLDERS[0] if worker.startswith("sim") else _FOLDERS[1]


def begin_logs(directory: Path, prefix: str, max_mb: int) -> None:
    """Have a training that starts anew write new logs; those of the last few trainings are kept.

    Args:
        directory: The racer's working folder.
        prefix: The model.
        max_mb: DR_LOG_MAX_MB.

    Raises:
        SettingsError: They may not be renamed.
    """
    folders = [_folder(directory, prefix, kind) for kind in _FOLDERS]
    try:
        log_files.set_aside(folders, max_mb << 20)
    except OSError as e:
        raise SettingsError(
            f"{e.filename}: the log of the training before cannot be renamed ({e.strerror or e}).",
            remedy=f"Check that you may write to {directory / 'data' / 'logs'}, or move that "
            "folder away.",
        ) from e


def _folder(directory: Path, prefix: str, kind: str) -> Path:
    return directory / "data" / "logs" / kind / prefix
