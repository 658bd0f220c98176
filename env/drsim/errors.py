"""What can go wrong in the simulation through no fault of its own; each message says what to do."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any


class TrackError(ValueError):
    """A track that cannot be found or whose numbers make no track."""


class RewardError(RuntimeError):
    """A reward function that cannot be loaded, fails, or returns something that is no reward.

    Attributes:
        file: The user's file, where known.
        line: Line in that file, counted from 1, where known.
        source: The text of that line, or an empty string.
        params: The parameters of the failing call in short form; empty when loading failed.
    """

    def __init__(
        self,
        message: str,
        *,
        file: Path | None = None,
        line: int | None = None,
        source: str = "",
        params: Mapping[str, Any] | None = None,
    ) -> None:
        """Keep the place beside the sentence; the sentence alone must suffice for a reader."""
        super().__init__(message)
        self.file = file
        self.line = line
        self.source = source
        self.params: dict[str, Any] = dict(params or {})
