"""Exceptions for wrong input to the simulation; each message says what to do."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

RewardErrorKind = Literal["load", "signature", "raises", "endless", "type", "range", "discard"]
"""What is wrong with a reward function: its file, its parameters or its kind, an exception, a call
that does not return, a value that is not a number, a number outside the limits. With `discard`, the
function itself is in order: it declares that its episode is broken."""


class DiscardEpisode(Exception):
    """A reward function raises this to declare its episode broken.

    The episode ends in this step, and no training learns from it. A reward function that must run
    without drsim may define an exception class of this name in its own file instead.
    """


class TrackError(ValueError):
    """A track that cannot be found, or a route that is not a track."""


class RewardError(RuntimeError):
    """A reward function that cannot be loaded, fails, or returns something that is not a reward.

    `file` and `line` (from 1) say where, if known, `source` is the text of that line, and `params`
    are the parameters of the failing call that the file reads, in short form. `kind` says what is
    wrong, `reason` what went wrong, without the place: for a call such as "KeyError: 'sped'", for
    the file a whole sentence.
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
        """Keep the details beside the message, which is complete without them."""
        super().__init__(message)
        self.file = file
        self.line = line
        self.source = source
        self.params: dict[str, Any] = dict(params or {})
        self.kind = kind
        self.reason = reason
