"""What is wrong in the racer's files, collected so that one start reports all of it at once."""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from drcli.base.errors import SettingsError

MOST_SHOWN = 40
"""Findings that one error lists; a file with more of them was named by mistake."""

LONGEST_SHOWN = 80
"""Characters of a value that an error repeats; enough to recognise it, short enough to read."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        where: Place, such as `run.env line 7`.
        what: Key, value and what is wrong with it, without a full stop.
        remedy: What to do about it, starting with a verb.
    """

    where: str
    what: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}."

    @classmethod
    def of(cls, error: SettingsError) -> "Finding":
        """The one thing that an error of the form `place: what is wrong.` reports."""
        where, _, what = str(error).partition(": ")
        return cls(where, what.removesuffix("."), error.remedy)


class UnfitError(ValueError):
    """A value that its type allows but its meaning does not.

    Args:
        reason: What is wrong, to be read after the value: `is empty`.
        remedy: What to write instead.
    """

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(reason)
        self.reason = reason
        self.remedy = remedy


class FindingsError(SettingsError):
    """Everything that is wrong: a line each, and as many lines of remedies in the same order.

    Args:
        findings: At least one.
        warnings: What was noticed beside them.
    """

    def __init__(self, findings: Sequence[Finding], warnings: Sequence[str] = ()) -> None:
        remedies = (finding.remedy for finding in findings[:MOST_SHOWN])
        super().__init__("\n".join(few(map(str, findings))), remedy="\n".join(remedies))
        self.findings = tuple(findings)
        self.warnings = tuple(warnings)


def settings_error(findings: Sequence[Finding]) -> FindingsError:
    """All findings as one failure."""
    return FindingsError(findings)


def few(sentences: Iterable[str]) -> list[str]:
    """The first of many sentences, and how many more there are."""
    everything = list(sentences)
    more = len(everything) - MOST_SHOWN
    return everything if more <= 0 else [*everything[:MOST_SHOWN], f"And {more:,} more like these."]


def shown(value: str) -> str:
    """A value as it may stand in a sentence: short, on one line, safe for any terminal."""
    text = value if value.isprintable() else ascii(value)
    return text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + "..."


def closest(word: str, words: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The word that was probably meant, in its own spelling.

    Args:
        word: What was written.
        words: What exists.
        cutoff: Least similarity, 0 to 1.
    """
    by_fold = {candidate.casefold(): candidate for candidate in words}
    matches = difflib.get_close_matches(word[:200].casefold(), by_fold, n=1, cutoff=cutoff)
    return by_fold[matches[0]] if matches else None


def one_of(words: Sequence[str], written: str) -> str:
    """A remedy that names the allowed words, the likely one first."""
    likely = closest(written, words)
    start = f"Did you mean {likely}? " if likely is not None else ""
    return f"{start}Write one of {', '.join(words)}."
