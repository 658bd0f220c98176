"""A racer's note about a model, one object in the bucket."""

import re
import secrets
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

from drcli.base.json_record import JsonRecord, RecordError
from drcli.bucket.bucket import (
    Bucket,
    ObjectDamaged,
    ObjectInfo,
    ObjectMissing,
    ObjectNewer,
    read_record,
    remedy_of,
)
from drcli.model import keys


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


# Notes of a model, each an object, so none can overwrite another.


DESCRIPTION = "000-description"

_STAMPED = re.compile(r"\d{18}-")


@dataclass(frozen=True)
class StoredNote:
    """`name` is without folder and end; `record` is None if damaged."""

    name: str
    record: NoteRecord | None
    problem: str = ""


def read_notes(bucket: Bucket, prefix: str) -> list[StoredNote]:
    """The description, then oldest first."""
    found = []
    for info in bucket.list(keys.notes_folder(prefix)):
        name = _name_of(prefix, info.key)
        note = None if name is None else _read(bucket, prefix, name)
        if note is not None:
            found.append(note)
    return found


def headline(bucket: Bucket, prefix: str, objects: Mapping[str, ObjectInfo]) -> str:
    names = sorted(name for key in objects if (name := _name_of(prefix, key)) is not None)
    if not names:
        return ""
    note = _read(bucket, prefix, DESCRIPTION if DESCRIPTION in names else names[-1])
    return "" if note is None or note.record is None else note.record.text


def add_note(bucket: Bucket, prefix: str, text: str, checkpoint: int | None) -> StoredNote:
    now = time.time()
    listed = bucket.list(keys.notes_folder(prefix))
    known = [_name_of(prefix, info.key) or "" for info in listed]
    stamps = [int(name[:18]) for name in known if _STAMPED.match(name)]
    # Later than all others, also if two are written in one moment or a clock was set back.
    stamp = max([int(now * 1e6), *(stamp + 1 for stamp in stamps)])
    name = f"{stamp:018d}-{secrets.token_hex(3)}"
    return _write(bucket, prefix, name, NoteRecord(now, text, socket.gethostname(), checkpoint))


def change_note(bucket: Bucket, prefix: str, note: StoredNote, text: str) -> StoredNote:
    now = time.time()
    record = note.record or NoteRecord(now, text, socket.gethostname())
    return _write(bucket, prefix, note.name, replace(record, text=text, edited_at=now))


def remove_note(bucket: Bucket, prefix: str, note: StoredNote) -> None:
    bucket.delete([keys.note(prefix, note.name)])


def describe(bucket: Bucket, prefix: str, text: str, *, is_new: bool = True) -> None:
    if text.strip() and (is_new or not bucket.exists(keys.note(prefix, DESCRIPTION))):
        write_description(bucket, prefix, text)


def write_description(bucket: Bucket, prefix: str, text: str) -> StoredNote:
    return _write(bucket, prefix, DESCRIPTION, NoteRecord(time.time(), text, socket.gethostname()))


def _name_of(prefix: str, key: str) -> str | None:
    found = re.fullmatch(re.escape(keys.notes_folder(prefix)) + r"([\w-]+)\.json", key)
    return None if found is None else found[1]


def _read(bucket: Bucket, prefix: str, name: str) -> StoredNote | None:
    key = keys.note(prefix, name)
    try:
        record = read_record(bucket, key, NoteRecord.decode, remedy_of(key))
    except ObjectMissing:
        return None
    except (ObjectDamaged, ObjectNewer) as error:
        return StoredNote(name, None, str(error))
    return StoredNote(name, record)


def _write(bucket: Bucket, prefix: str, name: str, record: NoteRecord) -> StoredNote:
    bucket.put(keys.note(prefix, name), record.encode())
    return StoredNote(name, record)
