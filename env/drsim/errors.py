"""Exceptions for wrong input to the simulation; each message says what to do."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

RewardErrorKind = Literal["load", "signature", "raises", "endless", "type", "range", "discard"]
"""What is wrong: file, parameters, an exception, a call that does not return, a value that is not
a number or outside the limits; `discard` declares an episode broken.
"""


class DiscardEpisode(Exception):
    """A reward function raises this to declare its episode broken.

    The episode ends in this step, and no training learns from it. A file that must run without
    drsim may define an exception of this name itself.
    """


class TrackError(ValueError):
    """A track that cannot be found, or a route that is not a track."""


class RewardError(RuntimeError):
    """A reward function that cannot be loaded, fails, or returns something that is not a reward.

    `line` counts from 1, `source` is its text; `params` are those that the file reads; `reason` is
    such as "KeyError: 'sped'", or a whole sentence.
    """

    def __init__(
        self,
        message: str,
        *,
        kind: RewardErrorKind,
        reason: str,
        file: Path | None = None,
        line: int | None = None,
        source: str = "",
        params: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(message)
        self.file = file
        self.line = line
        self.source = source
        self.params: dict[str, Any] = dict(params or {})
        self.kind = kind
        self.reason = reason


def require(good: bool, name: str, value: object, what: str) -> None:
    """Raise ValueError for a value that does not fit; it must `what`."""
    if not good:
        raise ValueError(f"{name} is {value}; it must {what}.")
