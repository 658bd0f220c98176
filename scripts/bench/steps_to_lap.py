"""What benchmarks that count the steps until a lap have in common: options, training, results."""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from learn_runs import MemoryTraining

TRIALS = 5
"""Evaluation laps of each checkpoint."""


def add_options(parser: argparse.ArgumentParser, *, cap: int) -> None:
    """Add the options that these benchmarks share.

    Args:
        parser: Of the benchmark.
        cap: Most steps of a training, unless --cap says otherwise.
    """
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--results", type=Path, help="file to append to and to go on from")
    parser.add_argument("--cap", type=int, default=cap, help="most steps of a training")
    parser.add_argument("--world", default="reinvent_base")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--precision", choices=["auto", "fp32", "bf16"], default="fp32")
    parser.add_argument("--json", action="store_true")


def settings_of(options: argparse.Namespace) -> dict[str, str]:
    """The settings that the options ask for."""
    return {
        "DR_WORLD_NAME": options.world,
        "DR_TRACKS_DIR": "",
        "DR_TORCH_PRECISION": options.precision,
    }


def checkpoints(training: MemoryTraining, cap: int) -> Iterator[tuple[int, list[bool]]]:
    """Train, and end the training when nobody asks for another checkpoint.

    Yields:
        For each checkpoint below `cap` steps: the steps it was learned from, and for each of its
        evaluation laps whether it was completed.
    """
    try:
        while training.steps < cap:
            steps = training.steps
            training.iterate()
            yield steps, [episode.completed for episode in training.evaluation]
    finally:
        training.close()


def records(path: Path | None) -> list[dict[str, Any]]:
    """What was measured before."""
    if path is None or not path.exists():
        return []
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def append(path: Path | None, result: Any) -> None:
    """Write a result, a dataclass, down at once: the benchmark may be stopped."""
    if path is not None:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(result)) + "\n")
