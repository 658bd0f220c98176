"""Errors that a user can see: sentence, remedy, exit code."""

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple


class DrError(Exception):
    """An error that is explained to the user; others are shown as tracebacks.

    `remedy` starts with a verb.
    """

    code: ClassVar[int] = 1
    final: ClassVar[bool] = False

    def __init__(self, message: str, *, remedy: str) -> None:
        super().__init__(message)
        self.remedy = remedy

    def __reduce__(self) -> tuple[Any, ...]:
        """For other processes: `__init__` of a kind may want more than the message."""
        return Exception.__new__, (type(self), *self.args), self.__dict__


class SettingsError(DrError):
    """A setting, parameter file or reward function is wrong."""

    code = 3
    final = True


class StorageError(DrError):
    """The bucket cannot be reached, read or written."""

    code = 4


class NoAnswer(StorageError):
    """The bucket's server is down or stuck."""


class NoKeys(StorageError):
    """This machine has no keys for the bucket."""


class NotYet(StorageError):
    """The same command may find a bucket or keys later.

    EX_TEMPFAIL of sysexits.h: service managers and schedulers try again.
    """

    code = 75


class DiskFull(StorageError):
    """Of the bucket."""

    final = True


class WorkerDied(DrError):
    """Starting a worker again did not help."""

    code = 5


class TrainingFailed(DrError):
    """Learning cannot continue; what was learned is kept."""

    code = 6
    final = True


class OwnershipLost(DrError):
    """Another training has taken over the model."""

    code = 8
    final = True


class TrainedElsewhere(DrError):
    """Another process trains the model, and this one was asked not to wait."""

    code = 9
    final = True


class EndWorkFailed(DrError):
    """An upload or import after a complete training failed."""

    code = 10
    final = True


class BudgetUsedUp(DrError):
    """Of the day. EX_TEMPFAIL of sysexits.h."""

    code = 75
    final = True


class NotAvailable(DrError):
    """A feature is not implemented, or a program is not installed."""

    code = 7
    final = True


class Aborted(DrError):
    """Nothing was changed. Source of the code: the reference."""

    final = True


class Absent(DrError):
    """Not running. Source of the code: the reference."""

    final = True


class OutputLost(DrError):
    """The result cannot be printed."""

    final = True


# Problems in the racer's files.


Severity = Literal["error", "warning", "note"]
"""Only errors prevent a start; `dr-start-training` asks about notes."""

MOST_SHOWN = 40
LISTED = "`dr-validate --console-compatible` lists all."
LONGEST_SHOWN = 80


class Place(NamedTuple):
    """A file, or `environment`, `flag` or `default`."""

    file: str
    line: int | None = None

    def __str__(self) -> str:
        return self.file if self.line is None else f"{self.file} line {self.line}"


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong or odd, in one place; see `JSON_KEYS`.

    Attributes:
        file: As in `Place`; empty if there is none.
        key: The setting or key; empty if there is none.
        several: What to call more of this kind in a file, after their number; empty if each
            stands for itself.
    """

    rule: str
    severity: Severity
    file: str
    line: int | None
    message: str
    remedy: str
    key: str = ""
    several: str = ""

    JSON_KEYS: ClassVar[Mapping[str, str]] = {
        "rule": "Number of the violated rule, such as `V-41`.",
        "severity": "`error` prevents a training from starting, `warning` does not, `note` tells "
        "you what `dr-start-training` will ask.",
        "where": "Place, such as `custom_files/hyperparameters.json line 3`; empty if there is "
        "none.",
        "message": "Key, value and problem, as a sentence.",
        "remedy": "How to fix it, starting with a verb.",
    }
    """What programs read, with the meaning of each key."""

    @property
    def where(self) -> str:
        """The place, such as `run.env line 7`."""
        return str(Place(self.file, self.line))

    def __str__(self) -> str:
        """The message with its place, unless it names that itself."""
        if not self.where or _names(self.message, self.where):
            return self.message
        return f"{self.where}: {self.message}"

    def as_json(self) -> dict[str, str]:
        """The values of `JSON_KEYS`."""
        return {key: getattr(self, key) for key in self.JSON_KEYS}


class BadValue(ValueError):
    """The right type, but not allowed; `reason` is as in `is empty`."""

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(reason)
        self.reason = reason
        self.remedy = remedy


def not_one_of(words: Sequence[str], written: str) -> BadValue:
    """A word that is not in a list, which the reason shows."""
    likely = closest(written, words)
    start = f"Did you mean {likely}? " if likely is not None else ""
    return BadValue(f"is not one of {', '.join(words)}", f"{start}Write one of these.")


class ProblemsError(SettingsError):
    """At least one error."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        shown = self.errors[:MOST_SHOWN]
        super().__init__(
            "\n".join(few(_on_one_line(str(problem)) for problem in self.errors)),
            remedy="\n".join(_on_one_line(problem.remedy) for problem in shown),
        )

    @property
    def errors(self) -> tuple[Problem, ...]:
        return tuple(problem for problem in self.problems if problem.severity == "error")


def of_severity(problems: Iterable[Problem], severity: Severity) -> tuple[Problem, ...]:
    """Each once, sorted by rule, file and line."""
    distinct = dict.fromkeys(problem for problem in problems if problem.severity == severity)
    return tuple(sorted(distinct, key=lambda p: (p.rule, p.file, p.line or 0)))


def grouped(problems: Iterable[Problem]) -> list[Problem]:
    """Warnings of one kind in a file become one, with the first as an example."""
    kinds: dict[object, list[Problem]] = {}
    for each in problems:
        alike = each.several and each.severity == "warning"
        kind = (each.rule, each.file, each.several) if alike else each
        kinds.setdefault(kind, []).append(each)
    found = []
    for first, *others in kinds.values():
        if others and first.several:
            message = f"{len(others) + 1} {first.several}, such as: {first.message}"
            first = replace(first, message=message, remedy=f"{first.remedy} {LISTED}")
        found.append(first)
    return found


def refuse(problems: Iterable[Problem]) -> None:
    """Raises ProblemsError with all of them, errors first, if there is an error."""
    found = tuple(problems)
    errors = of_severity(found, "error")
    if errors:
        raise ProblemsError([*errors, *(each for each in found if each.severity != "error")])


def few(sentences: Iterable[str]) -> list[str]:
    """First ones, and how many more."""
    everything = list(sentences)
    more = len(everything) - MOST_SHOWN
    return everything if more <= 0 else [*everything[:MOST_SHOWN], f"And {more:,} more like these."]


def shown(value: str) -> str:
    """Short, on one line, safe for any terminal."""
    text = value if value.isprintable() else ascii(value)
    return text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + "..."


def closest(word: str, words: Iterable[str], cutoff: float = 0.6) -> str | None:
    """What was probably meant; `cutoff`: least similarity, 0 to 1."""
    by_fold = {candidate.casefold(): candidate for candidate in words}
    matches = difflib.get_close_matches(word[:200].casefold(), by_fold, n=1, cutoff=cutoff)
    return by_fold[matches[0]] if matches else None


def one_of(words: Sequence[str], written: str) -> str:
    likely = closest(written, words)
    start = f"Did you mean {likely}? " if likely is not None else ""
    return f"{start}Write one of {', '.join(words)}."


def _names(message: str, place: str) -> bool:
    """`run.env line 12` is not line 1."""
    return bool(re.search(rf"(?<![\w./-]){re.escape(place)}(?![\w/-]|\.\w)", message))


def _on_one_line(text: str) -> str:
    return " ".join(map(str.strip, text.splitlines()))


# Messages from below the command line: a command shows them, a worker logs them.


QUIET_S = 1.0


def _ignore(_text: str) -> None:
    pass


show: Callable[[str], None] = _ignore
warn: Callable[[str], None] = _ignore


# Why a server could not be reached, in a few words.


_WORDS = {
    "NameResolutionError": "its name is unknown",
    "gaierror": "its name is unknown",
    "ConnectionRefusedError": "it refuses the connection",
    "ConnectionResetError": "it closed the connection",
    "RemoteDisconnected": "it closed the connection",
    "IncompleteRead": "it closed the connection too early",
    "SSLCertVerificationError": "nobody whom this machine trusts has signed it",
}


def cause_of(error: BaseException) -> str:
    seen: list[BaseException] = []
    waiting: list[object] = [error]
    while waiting:
        one = waiting.pop()
        if isinstance(one, BaseException) and one not in seen:
            seen.append(one)
            waiting += [one.__cause__, one.__context__, getattr(one, "reason", None), *one.args]
    known = [_WORDS[type(one).__name__] for one in seen if type(one).__name__ in _WORDS]
    if known:
        return known[-1]
    systems = [one.strerror for one in seen if isinstance(one, OSError) and one.strerror]
    return (systems[-1] if systems else type(error).__name__).rstrip(".")
