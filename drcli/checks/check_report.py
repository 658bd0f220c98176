"""The report on the rules in a working folder."""

from dataclasses import dataclass

from drcli.base.errors import Problem


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
    """All problems of a working folder.

    Attributes:
        directory: The folder. Places inside it are named relative to it.
        console_compatible: Whether the model is also meant for training on a DeepRacer console.
        errors: Problems that prevent a training from starting.
        warnings: Things that work but may surprise you.
        skipped: Rules that could not be checked.
        notes: What `dr-start-training` will ask.
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
