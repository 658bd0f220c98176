"""Where the logs of a run are, here and in the bucket."""

from pathlib import Path

KINDS = ("robomaker", "sagemaker", "reward")
"""Folders. log-guru fails on other logs among simulation logs."""

REWARD = "reward-"


def log_kind(name: str) -> str:
    simulation, others, reward = KINDS
    if name.startswith(REWARD):
        return reward
    return simulation if name.startswith(("sim", "joined")) else others


def log_folder(directory: Path, prefix: str, kind: str) -> Path:
    return directory / "data" / "logs" / kind / prefix


def log_file(directory: Path, prefix: str, name: str) -> Path:
    """For "trainer", "supervisor", "sim-0", ..."""
    return log_folder(directory, prefix, log_kind(name)) / f"{name}.log"


def json_log(log: Path) -> Path:
    return log.with_suffix(".jsonl")


def reward_log(worker: str) -> str:
    """The racer's prints: `reward-0` for `sim-0`."""
    return REWARD + worker.removeprefix("sim-")
