"""Where the logs of the processes of a run are, on this machine and by kind in the bucket."""

from pathlib import Path

KINDS = ("robomaker", "sagemaker", "reward")
"""Folders of logs. Simulation logs have their own, because log-guru fails if it finds any other
log there."""

REWARD = "reward-"
"""Beginning of the name of a log with what the racer's code prints."""


def log_kind(name: str) -> str:
    """The folder of a log, on disk and in the bucket."""
    simulation, others, reward = KINDS
    if name.startswith(REWARD):
        return reward
    return simulation if name.startswith(("sim", "joined")) else others


def log_folder(directory: Path, prefix: str, kind: str) -> Path:
    """The folder with the logs of one kind of a model on this machine."""
    return directory / "data" / "logs" / kind / prefix


def log_file(directory: Path, prefix: str, name: str) -> Path:
    """A log of this machine: of a worker ("trainer", "supervisor", "sim-0", ...) or its prints."""
    return log_folder(directory, prefix, log_kind(name)) / f"{name}.log"


def json_log(log: Path) -> Path:
    """The same log as JSON lines, which a process writes beside it if DR_LOG_JSON is on."""
    return log.with_suffix(".jsonl")


def reward_log(worker: str) -> str:
    """The log with what the racer's code prints in a worker: `reward-0` for `sim-0`."""
    return REWARD + worker.removeprefix("sim-")
