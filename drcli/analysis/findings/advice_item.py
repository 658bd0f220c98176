"""A piece of advice, and its command."""

import shlex
from dataclasses import dataclass


@dataclass(frozen=True)
class Advice:
    """Something to change; docs/advice.md has a section for each id."""

    id: str
    title: str
    evidence: str
    numbers: dict[str, float]
    setting: str
    command: str


TRAIN_ON = ("DR_TRAIN_MAX_MINUTES", "dr-start-training --resume")


def train_on(*changes: str, checkpoint: str = "") -> str:
    """The command that trains on, with `changes` such as `lr=0.0001`."""
    words = ["dr-increment-training", "-f"]
    if checkpoint:
        words += ["--checkpoint", checkpoint]
    for change in changes:
        words += ["--hyperparameter", change]
    return shlex.join(words)


def rounded(value: float) -> str:
    return f"{float(f'{value:.0e}'):.10f}".rstrip("0").rstrip(".")
