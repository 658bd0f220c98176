"""What a report looks like, said where its values are: columns at fields, sentences in methods.

A report is a frozen dataclass. For people it has `view()`, or `__str__` if that is one sentence:
    str: a line; false ones are left out;
    tuple: one line of several pieces;
    list: indented parts;
    dict: names and values; false values are left out;
    Rows: a table;
    Log: lines whose pieces stand below each other;
    Curve: numbers as heights.
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, Self, get_type_hints

View = Iterable[object]
BLANK = " "
"""An empty line."""
Cell = str | tuple[str, ...]
Style = str | Mapping[str, str]


class Styled(str):
    """Text in a style of the library rich."""

    style: str

    def __new__(cls, text: object, style: str) -> Self:
        made = super().__new__(cls, text)
        made.style = style
        return made


def bold(text: object) -> Styled:
    return Styled(text, "bold")


def dim(text: object) -> Styled:
    return Styled(text, "dim")


@dataclass(frozen=True)
class Col:
    """A field as a column; an `Annotated` field may also have a description for docs, a string.

    Attributes:
        form: A format or a function, for values that are not None.
        of: Makes the value of the whole row.
        side: Texts stand left, numbers right.
        style: Of all its cells, or of those with this text.
        wide: Left out where the terminal has no room for it.
    """

    name: str
    form: str | Callable[[Any], str] = "{}"
    of: Callable[[Any], object] | None = None
    side: Literal["left", "right", ""] = ""
    none: str = "-"
    style: Style = ""
    wide: bool = False

    def cell(self, row: Any, field: str) -> Cell:
        """What stands in a row."""
        value = getattr(row, field) if self.of is None else self.of(row)
        if value is None or isinstance(value, Styled | tuple):
            return self.none if value is None else value
        text = self.form.format(value) if isinstance(self.form, str) else self.form(value)
        style = self.style if isinstance(self.style, str) else self.style.get(text, "")
        return Styled(text, style) if style else text


@dataclass(frozen=True)
class Rows:
    """A table, or a list where its rows do not fit; `wide`: columns that may be left out.

    Without rows, it is left out.
    """

    names: Sequence[str]
    cells: Sequence[Sequence[Cell]]
    left: Sequence[str] = ()
    wide: Sequence[str] = ()

    def __len__(self) -> int:
        return len(self.cells)


@dataclass(frozen=True)
class Log:
    """Lines of pieces, below each other; the last piece is long."""

    lines: Sequence[Sequence[object]]


@dataclass(frozen=True)
class Curve:
    """Numbers as a line of heights, from 0 or the least to `top` or the greatest."""

    name: str
    values: Sequence[float]
    said: str = ""
    style: str = "cyan"
    top: float | None = None


@cache
def columns(kind: type) -> dict[str, Col]:
    """The fields of a class that are columns."""
    hints = get_type_hints(kind, include_extras=True)
    marks = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    return {name: mark for name, found in marks.items() for mark in found if isinstance(mark, Col)}


def table(rows: Sequence[Any], *shown: str | Col, **renamed: str) -> Rows:
    """A table of objects of one class; columns without text are left out.

    `shown` are fields and other columns in their order, by default all columns of the class;
    `renamed` names fields otherwise.
    """
    if not rows:
        return Rows((), ())
    kind: Any = type(rows[0])
    known = columns(kind)
    found = []
    for each in shown or known:
        name, col = (each, known[each]) if isinstance(each, str) else ("", each)
        cells = [col.cell(row, name) for row in rows]
        if any(cells):
            found.append((renamed.get(name, col.name), col, cells, _side(rows, name, col)))
    return Rows(
        [name for name, *_ in found],
        list(zip(*(cells for _, _, cells, _ in found), strict=True)),
        [name for name, _, _, side in found if side == "left"],
        [name for name, col, *_ in found if col.wide],
    )


def _side(rows: Sequence[Any], name: str, col: Col) -> str:
    if col.side or col.of:
        return col.side
    is_text = all(isinstance(getattr(row, name), str | list | None) for row in rows)
    return "left" if is_text else ""


def counted(number: int, word: str) -> str:
    return f"{number:,} {word}" + ("" if number == 1 else "s")


def size_text(size_bytes: int) -> str:
    """Decimal: 1.5 MB."""
    if size_bytes < 1000:
        return counted(size_bytes, "byte")
    size, unit = size_bytes / 1000, "kB"
    for larger in ("MB", "GB", "TB"):
        if size >= 1000:
            size, unit = size / 1000, larger
    return f"{size:,.1f} {unit}"


def minute(at: float) -> str:
    """In local time."""
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(at))


def second(iso: str) -> str:
    """Of ISO 8601."""
    return iso[:19].replace("T", " ") or "-"


def utc_second(at: float) -> str:
    """`?` for what is no time."""
    with suppress(ValueError, OverflowError, OSError):
        return time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(at))
    return "?"


def utc_minute(at: float | None) -> str:
    return "" if at is None else utc_second(at)[:16]


def printable(text: str) -> str:
    """Without what would control a terminal."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def abridged(text: str) -> str:
    """In at most 60 letters."""
    words = " ".join(printable(text).split())
    return words if len(words) <= 60 else f"{words[:57]}..."


def compact(value: float) -> str:
    """Four digits."""
    return f"{value:,.4g}" if abs(value) < 1e4 else f"{value:,.0f}"


def clock(elapsed_s: float) -> str:
    """As in 1:02:03."""
    minutes, seconds = divmod(max(0, int(elapsed_s)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
