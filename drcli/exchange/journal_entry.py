"""An event in the journal of a run."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from drcli.base.json_record import JsonRecord

Kind = Literal["start", "notice", "fault", "recovery", "stage", "upload", "message", "end"]
"""`fault`: something broke; `recovery`: was put right."""


@dataclass(frozen=True)
class JournalEntry(JsonRecord):
    """`at` is Unix seconds, `text` for people, `facts` for programs."""

    at: float
    kind: Kind
    text: str
    facts: Mapping[str, Any] = field(default_factory=dict)

    def encode_line(self) -> bytes:
        return self.encode() + b"\n"
