"""What the rules found: violations, kept apart by severity, and rules that could not be tried."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from drcli.base.errors import SettingsError

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Violation:
    """One rule that is broken in one place.

    Attributes:
        rule: Its number, such as `V-41`.
        severity: An error keeps a training from starting, a warning does not. A note is no fault:
            it says what a start will ask for.
        where: Place, such as `custom_files/hyperparameters.json line 3`; empty if there is none.
        message: Key, value and what is wrong with it, as a sentence.
        remedy: What to do about it, starting with a verb.
    """

    rule: str
    severity: Severity
    where: str
    message: str
    remedy: str

    @property
    def sentence(self) -> str:
        """The message with its place, unless it names that itself."""
        return self.message if self.where in self.message else f"{self.where}: {self.message}"


@dataclass(frozen=True)
class Skipped:
    """Rules that could not be tried.

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
        skipped: Rules that could not be tried.
        notes: What is as it should be, and what a start needs to be told about it.
    """

    directory: str
    console_compatible: bool
    errors: tuple[Violation, ...]
    warnings: tuple[Violation, ...]
    skipped: tuple[Skipped, ...]
    notes: tuple[Violation, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether a training could start."""
        return not self.errors


def by_severity(
    violations: Iterable[Violation],
) -> tuple[tuple[Violation, ...], tuple[Violation, ...]]:
    """Errors and warnings, each once, in the order of rules, files and lines."""
    ordered = list(violations)
    return of_severity(ordered, "error"), of_severity(ordered, "warning")


def of_severity(violations: Iterable[Violation], severity: Severity) -> tuple[Violation, ...]:
    """Those of one severity, each once, in the order of rules, files and lines."""
    distinct = sorted(dict.fromkeys(violations), key=_position)
    return tuple(violation for violation in distinct if violation.severity == severity)


def refuse(violations: Iterable[Violation]) -> None:
    """Refuse to go on if there are errors.

    Raises:
        SettingsError: A line for each error, and as many lines of remedies in the same order.
    """
    errors, _ = by_severity(violations)
    if errors:
        raise SettingsError(
            "\n".join(" ".join(error.sentence.splitlines()) for error in errors),
            remedy="\n".join(" ".join(error.remedy.splitlines()) for error in errors),
        )


def _position(violation: Violation) -> tuple[str, str, int]:
    file, _, line = violation.where.partition(" line ")
    number = line.partition(" ")[0]
    return violation.rule, file, int(number) if number.isdigit() else 0
