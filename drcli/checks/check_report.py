"""What the rules found in a working folder, and what a trial leaves for the process that waits."""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from drcli.base.problems import Problem

_TRIAL_FILE = "trial.json"
"""What a trial in a process of its own leaves in its job's folder."""


@dataclass(frozen=True)
class Skipped:
    """Rules that could not be checked.

    Attributes:
        rules: Their numbers.
        reason: Why, as a sentence.
    """

    rules: tuple[str, ...]
    reason: str


@dataclass(frozen=True)
class Report:
    """Everything there is to say about a working folder.

    Attributes:
        directory: The folder. Places inside it are named relative to it.
        console_compatible: Whether the model shall train on a DeepRacer console too.
        errors: What keeps a training from starting.
        warnings: What may surprise.
        skipped: Rules that could not be checked.
        notes: What is not wrong, but what a start will ask for.
    """

    directory: str
    console_compatible: bool
    errors: tuple[Problem, ...]
    warnings: tuple[Problem, ...]
    skipped: tuple[Skipped, ...]
    notes: tuple[Problem, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether a training could start."""
        return not self.errors


def forget_tried(folder: Path) -> None:
    """Remove what an earlier trial has left."""
    (folder / _TRIAL_FILE).unlink(missing_ok=True)


def leave_tried(problems: Iterable[Problem], folder: Path) -> None:
    """Leave what a trial has found for the process that waits for it."""
    (folder / _TRIAL_FILE).write_text(json.dumps([asdict(item) for item in problems]), "utf-8")


def find_tried(folder: Path) -> list[Problem] | None:
    """What a trial has found; None where it did not come to that."""
    path = folder / _TRIAL_FILE
    if not path.exists():
        return None
    try:
        return [Problem(**fields) for fields in json.loads(path.read_text("utf-8"))]
    except (ValueError, TypeError):  # it was ended while it wrote
        return None
