"""An event in the journal of a run."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from drcli.base.json_record import JsonRecord

Kind = Literal["start", "notice", "fault", "recovery", "stage", "upload", "message", "end"]
"""What an event is. `fault` and `recovery`: something broke, and was put right."""


@dataclass(frozen=True)
class JournalEntry(JsonRecord):
    """One event.

    Attributes:
        at: Unix seconds by the clock of the machine.
        kind: What it is.
        text: A sentence for people.
        facts: For programs.
    """

    at: float
    kind: Kind
    text: str
    facts: Mapping[str, Any] = field(default_factory=dict)

    def encode_line(self) -> bytes:
        """The event as a line of JSON."""
        return self.encode() + b"\n"
