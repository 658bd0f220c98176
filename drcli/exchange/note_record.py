"""A racer's note about a model, one object in the bucket."""

from dataclasses import dataclass

from drcli.base.json_record import JsonRecord, RecordError


@dataclass(frozen=True)
class NoteRecord(JsonRecord):
    at: float
    text: str
    host: str = ""
    checkpoint: int | None = None
    edited_at: float | None = None

    def __post_init__(self) -> None:
        if not self.text.strip():
            raise RecordError("it has no text")
