"""A piece of advice, and how the commands in it are written."""

import shlex
from dataclasses import dataclass


@dataclass(frozen=True)
class Advice:
    """Something that a racer should change, with what shows it.

    Attributes:
        id: Its name; docs/advice.md has a section for each.
        title: What is wrong, in a few words.
        evidence: What shows it, sentences with numbers.
        numbers: These numbers by name.
        setting: What to change: a setting, a hyperparameter, or a file.
        command: The command that does it, in the folder with the racer's run.env.
    """

    id: str
    title: str
    evidence: str
    numbers: dict[str, float]
    setting: str
    command: str


TRAIN_ON = ("DR_TRAIN_MAX_MINUTES", "dr-start-training --resume")
"""Setting and command where more training helps more than any change."""


def train_on(*changes: str, checkpoint: str = "") -> str:
    """The command that trains on from this model with some hyperparameters changed.

    Args:
        changes: Such as `lr=0.0001`.
        checkpoint: Where to begin; the last one if empty.
    """
    words = ["dr-increment-training", "-f"]
    if checkpoint:
        words += ["--checkpoint", checkpoint]
    for change in changes:
        words += ["--hyperparameter", change]
    return shlex.join(words)


def rounded(value: float) -> str:
    """A hyperparameter with one digit that counts, such as 0.0003."""
    return f"{float(f'{value:.0e}'):.10f}".rstrip("0").rstrip(".")
