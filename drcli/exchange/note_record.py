"""A note that the racer wrote about a model, one object in the bucket."""

from dataclasses import dataclass

from drcli.base.json_record import JsonRecord, RecordError


@dataclass(frozen=True)
class NoteRecord(JsonRecord):
    """A note.

    Attributes:
        at: When it was written, Unix seconds.
        text: What it says; never empty.
        host: The machine on which it was written.
        checkpoint: Number of the newest checkpoint then; None before the first.
        edited_at: When the text was last changed, Unix seconds; None if it never was.
    """

    at: float
    text: str
    host: str = ""
    checkpoint: int | None = None
    edited_at: float | None = None

    def __post_init__(self) -> None:
        if not self.text.strip():
            raise RecordError("it has no text")
