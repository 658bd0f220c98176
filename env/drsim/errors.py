"""What can go wrong in the simulation through no fault of its own; each message says what to do."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

RewardErrorKind = Literal["load", "signature", "raises", "endless", "type", "range"]
"""What is wrong with a reward function: its file, its parameters or its kind, an exception, a call
that does not return, a value that is not a number, a number outside the limits."""


class TrackError(ValueError):
    """A track that cannot be found or whose numbers make no track."""


class RewardError(RuntimeError):
    """A reward function that cannot be loaded, fails, or returns something that is no reward.

    Attributes:
        file: The user's file, where known.
        line: Line in that file, counted from 1, where known.
        source: The text of that line, or an empty string.
        params: The parameters of the failing call in short form; empty when loading failed.
        kind: What is wrong.
        reason: What went wrong, without the place: in a call such as "KeyError: 'sped'", else a
            whole sentence.
    """

    def __init__(
        self,
        message: str,
        *,
        file: Path | None = None,
        line: int | None = None,
        source: str = "",
        params: Mapping[str, Any] | None = None,
        kind: RewardErrorKind = "load",
        reason: str = "",
    ) -> None:
        """Keep the place beside the sentence; the sentence alone must suffice for a reader."""
        super().__init__(message)
        self.file = file
        self.line = line
        self.source = source
        self.params: dict[str, Any] = dict(params or {})
        self.kind = kind
        self.reason = reason
