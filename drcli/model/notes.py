"""A racer's note about a model, one object in the bucket."""

import re
import secrets
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

from drcli.base.json_record import JsonRecord, SafeInt, Seconds, Words
from drcli.bucket.bucket import (
    ObjectDamaged,
    ObjectInfo,
    ObjectNewer,
    find_record,
)
from drcli.model import keys
from drcli.model.model_store import ModelStore


@dataclass(frozen=True)
class NoteRecord(JsonRecord):
    at: float
    text: Words
    host: str = ""
    checkpoint: SafeInt | None = None
    edited_at: Seconds | None = None


# Notes of a model, each an object, so none can overwrite another.


DESCRIPTION = "000-description"

_STAMPED = re.compile(r"\d{18}-")


@dataclass(frozen=True)
class StoredNote:
    """`name` is without folder and end; `record` is None if damaged."""

    name: str
    record: NoteRecord | None
    problem: str = ""


def read_notes(model: ModelStore) -> list[StoredNote]:
    """The description, then oldest first."""
    found = []
    for info in model.bucket.list(keys.notes_folder(model.prefix)):
        name = _name_of(model.prefix, info.key)
        note = None if name is None else _read(model, name)
        if note is not None:
            found.append(note)
    return found


def headline(model: ModelStore, objects: Mapping[str, ObjectInfo]) -> str:
    names = sorted(name for key in objects if (name := _name_of(model.prefix, key)) is not None)
    if not names:
        return ""
    note = _read(model, DESCRIPTION if DESCRIPTION in names else names[-1])
    return "" if note is None or note.record is None else note.record.text


def add_note(model: ModelStore, text: str, checkpoint: int | None) -> StoredNote:
    now = time.time()
    listed = model.bucket.list(keys.notes_folder(model.prefix))
    known = [_name_of(model.prefix, info.key) or "" for info in listed]
    stamps = [int(name[:18]) for name in known if _STAMPED.match(name)]
    # Later than all others, also if two are written in one moment or a clock was set back.
    stamp = max([int(now * 1e6), *(stamp + 1 for stamp in stamps)])
    name = f"{stamp:018d}-{secrets.token_hex(3)}"
    return _write(model, name, NoteRecord(now, text, socket.gethostname(), checkpoint))


def change_note(model: ModelStore, note: StoredNote, text: str) -> StoredNote:
    now = time.time()
    record = note.record or NoteRecord(now, text, socket.gethostname())
    return _write(model, note.name, replace(record, text=text, edited_at=now))


def remove_note(model: ModelStore, note: StoredNote) -> None:
    model.bucket.delete([keys.note(model.prefix, note.name)])


def describe(model: ModelStore, text: str, *, is_new: bool = True) -> None:
    if text.strip() and (is_new or not model.bucket.exists(keys.note(model.prefix, DESCRIPTION))):
        write_description(model, text)


def write_description(model: ModelStore, text: str) -> StoredNote:
    return _write(model, DESCRIPTION, NoteRecord(time.time(), text, socket.gethostname()))


def _name_of(prefix: str, key: str) -> str | None:
    found = re.fullmatch(re.escape(keys.notes_folder(prefix)) + r"([\w-]+)\.json", key)
    return None if found is None else found[1]


def _read(model: ModelStore, name: str) -> StoredNote | None:
    try:
        record = find_record(model.bucket, keys.note(model.prefix, name), NoteRecord.decode)
    except (ObjectDamaged, ObjectNewer) as error:
        return StoredNote(name, None, str(error))
    return None if record is None else StoredNote(name, record)


def _write(model: ModelStore, name: str, record: NoteRecord) -> StoredNote:
    model.bucket.put(keys.note(model.prefix, name), record.encode())
    return StoredNote(name, record)
