"""Lists, adds, changes and removes a racer's notes about a model."""

from dataclasses import dataclass, field
from itertools import chain
from typing import Annotated

from drcli.base.errors import BadValue, SettingsError, shown
from drcli.base.report import View, abridged, bold, dim, printable, utc_minute
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.settings import Settings
from drcli.config.value_types import LONGEST_TEXT
from drcli.model import keys
from drcli.model.model_prefix import is_used, newest_checkpoint
from drcli.model.model_store import ModelStore
from drcli.model.notes import (
    DESCRIPTION,
    StoredNote,
    add_note,
    change_note,
    read_notes,
    remove_note,
    write_description,
)
from drcli.transfer.transfer_buckets import bucket_to_look_at


@dataclass(frozen=True)
class NoteEntry:
    """A note in the list."""

    number: Annotated[int, "Counted from 1; 0 is the description."]
    at: Annotated[float | None, "When it was written, Unix seconds; None if damaged."]
    edited_at: Annotated[float | None, "When it was last changed; None if never."]
    host: Annotated[str, "The machine on which it was written."]
    checkpoint: Annotated[int | None, "Number of the newest checkpoint then; None if unknown."]
    text: Annotated[str, "What it says."]

    def line(self) -> str:
        return f"{'Note' if self.number else 'Description'}: {abridged(self.text)}"

    def head(self) -> str:
        parts = [
            f"Note {self.number}" if self.number else "Description",
            utc_minute(self.at),
            "" if self.checkpoint is None else f"at checkpoint {self.checkpoint}",
            "" if self.edited_at is None else f"changed {utc_minute(self.edited_at)}",
        ]
        return ", ".join(filter(None, parts))


@dataclass(frozen=True)
class NoteList:
    """The notes of a model."""

    model: Annotated[str, "As s3://bucket/prefix."]
    notes: Annotated[list[NoteEntry], "The description, then the oldest first."] = field(
        default_factory=list
    )
    damaged: Annotated[list[str], "A sentence for each note that cannot be read."] = field(
        default_factory=list
    )

    def view(self) -> View:
        if not self.notes:
            return [f"{self.model} has no notes."]
        notes = ((dim(note.head()), [printable(note.text)]) for note in self.notes)
        return [bold(self.model), *chain.from_iterable(notes)]


def list_notes(settings: Settings, prefix: str | None) -> NoteList:
    """The notes of a model, by default the configured one.

    Raises:
        SettingsError: There is no such model.
    """
    bucket = bucket_to_look_at(settings.transfer, upload=False)
    return notes_of(_existing(ModelStore(bucket, _named(settings, prefix))))


def notes_of(model: ModelStore) -> NoteList:
    return _listed(model, read_notes(model))


def write_note(settings: Settings, prefix: str | None, text: str) -> NoteList:
    """Add a note, and return all.

    Raises:
        SettingsError: There is no such model, or the text cannot be a note.
    """
    store, words = _opened(settings, prefix), _checked(text)
    known = read_notes(store)  # before the change: nothing can fail once it is made
    newest = newest_checkpoint(store)
    added = add_note(store, words, None if newest is None else newest.number)
    return _listed(store, [*known, added])


def rewrite_note(settings: Settings, prefix: str | None, number: int, text: str) -> NoteList:
    """Replace a note; number 0 is the description, which need not exist.

    Raises:
        SettingsError: There is no such model or note, or the text cannot be one.
    """
    store, words = _opened(settings, prefix), _checked(text)
    found = read_notes(store)
    known = dict(_numbered(found))
    if number == 0 and number not in known:
        changed = write_description(store, words)
    else:
        changed = change_note(store, _of_number(known, number, store), words)
    others = [note for note in found if note.name != changed.name]
    return _listed(store, [*others, changed])


def delete_note(settings: Settings, prefix: str | None, number: int) -> NoteList:
    """Remove a note; the numbers of others change.

    Raises:
        SettingsError: There is no such model or note.
    """
    store = _opened(settings, prefix)
    found = read_notes(store)
    removed = _of_number(dict(_numbered(found)), number, store)
    remove_note(store, removed)
    return _listed(store, [note for note in found if note != removed])


def _listed(model: ModelStore, found: list[StoredNote]) -> NoteList:
    found = sorted(found, key=lambda note: note.name)
    entries = [_entry(number, note) for number, note in _numbered(found)]
    damaged = [note.problem for note in found if note.problem]
    return NoteList(model.url, entries, damaged)


def _numbered(found: list[StoredNote]) -> list[tuple[int, StoredNote]]:
    described = [(0, note) for note in found if note.name == DESCRIPTION]
    others = [note for note in found if note.name != DESCRIPTION]
    return [*described, *enumerate(others, start=1)]


def _entry(number: int, note: StoredNote) -> NoteEntry:
    if note.record is None:
        return NoteEntry(number, None, None, "", None, "(damaged)")
    record = note.record
    return NoteEntry(
        number, record.at, record.edited_at, record.host, record.checkpoint, record.text
    )


def _of_number(known: dict[int, StoredNote], number: int, model: ModelStore) -> StoredNote:
    if number not in known:
        there = ", ".join(map(str, known)) or "none"
        raise SettingsError(
            f"{model.url} has no note {number}; there are: {there}.",
            remedy="`dr-note list` shows them with their numbers.",
        )
    return known[number]


def _opened(settings: Settings, prefix: str | None) -> ModelStore:
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    return _existing(ModelStore(bucket, _named(settings, prefix)))


def _named(settings: Settings, prefix: str | None) -> str:
    return settings.model_prefix if prefix is None else prefix.rstrip("/")


def _existing(model: ModelStore) -> ModelStore:
    if not keys.is_valid_prefix(model.prefix) or not is_used(model):
        raise SettingsError(
            f"There is no model at {model.url}.",
            remedy="Start its training first, or name another with -p; `dr-list-models` lists all. "
            "DR_MODEL_DESCRIPTION describes a model that is still to be started.",
        )
    return model


def _checked(text: str) -> str:
    words = text.strip()
    try:
        words.encode()
        if not words:
            raise BadValue("is empty", "Write some words.")
        if len(words) > LONGEST_TEXT:
            raise BadValue("is too long", f"Write at most {LONGEST_TEXT} characters.")
    except UnicodeEncodeError:
        raise SettingsError("The note is not text in UTF-8.", remedy="Write it again.") from None
    except BadValue as error:
        raise SettingsError(f"The note {shown(text)} {error}.", remedy=error.remedy) from error
    return words
