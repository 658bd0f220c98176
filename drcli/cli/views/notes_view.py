"""Shows a model's notes."""

import time
from contextlib import suppress
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import indented

if TYPE_CHECKING:
    from drcli.transfer.model_notes import NoteEntry, NoteList

LONGEST = 60


def notes(found: "NoteList") -> RenderableType:
    if not found.notes:
        return Text(f"{found.model} has no notes.")
    parts: list[RenderableType] = [Text(found.model, style="bold")]
    for note in found.notes:
        parts += [Text(_head(note), style="dim"), indented(_printable(note.text))]
    return Group(*parts)


def short(text: str) -> str:
    words = " ".join(_printable(text).split())
    return words if len(words) <= LONGEST else f"{words[: LONGEST - 3]}..."


def line(note: "NoteEntry") -> str:
    return f"Description: {short(note.text)}" if note.number == 0 else f"Note: {short(note.text)}"


def _head(note: "NoteEntry") -> str:
    title = "Description" if note.number == 0 else f"Note {note.number}"
    parts = [title, _moment(note.at)]
    if note.checkpoint is not None:
        parts.append(f"at checkpoint {note.checkpoint}")
    if note.edited_at is not None:
        parts.append(f"changed {_moment(note.edited_at)}")
    return ", ".join(part for part in parts if part)


def _moment(at: float | None) -> str:
    if at is None:
        return ""
    with suppress(ValueError, OverflowError, OSError):
        return time.strftime("%Y-%m-%d %H:%M", time.gmtime(at))
    return "?"


def _printable(text: str) -> str:
    """Without what would control a terminal."""
    return "".join(letter if letter.isprintable() else " " for letter in text)
