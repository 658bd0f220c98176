"""Shows reports: for people in the width of the terminal, or as JSON."""

from collections.abc import Callable, Sequence
from functools import wraps
from itertools import pairwise
from typing import Any, Concatenate, ParamSpec, TypeVar

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from drcli.base.report import Curve, Log, Rows, dim
from drcli.cli import terminal
from drcli.cli.terminal import BOUNDLESS

INDENT = 2
BESIDE_COLUMNS = 80
"""Pieces are below each other within so many."""
_LEAST_NAME = 24

P = ParamSpec("P")
T = TypeVar("T")


def show(report: Any, *, folded: bool = True, **options: Any) -> None:
    """Print a report, or with --json one JSON object on the last line of stdout.

    Without `folded`, an address stays in one piece. The view gets the `options`.
    """
    rendered = None if terminal.as_json else drawn(report, **options)
    terminal.emit(report, rendered, folded=folded)


def drawn(report: Any, **options: Any) -> RenderableType:
    return group(report.view(**options) if hasattr(report, "view") else [str(report)])


def part(found: Any) -> RenderableType:
    """A part of a view, as drcli.base.report lists them."""
    if isinstance(found, Rows):
        return _Fitted(found)
    if isinstance(found, Log):
        return _Log(found)
    if isinstance(found, Curve):
        return _curve(found)
    if isinstance(found, dict):
        return _Log(Log([(dim(name), value) for name, value in found.items() if value]))
    return indented(group(found)) if isinstance(found, list) else _text(found)


def group(parts: Any) -> RenderableType:
    """Parts of a view, one below the other."""
    return Group(*(part(each) for each in parts if each))


def _text(found: Any) -> Text:
    if isinstance(found, tuple):
        return Text.assemble(*map(_text, found))
    return found if isinstance(found, Text) else Text(str(found), getattr(found, "style", ""))


def _curve(found: Curve) -> RenderableType:
    def draw(columns: int) -> RenderableType:
        name = f"{found.name:9}"
        room = columns - len(name) - len(found.said) - 2
        width = max(LEAST_CURVE_COLUMNS, min(CURVE_COLUMNS, room))
        heights = curve(found.values, width, top=found.top)
        drawn = (f"{heights:{width}}", found.style)
        return Text.assemble((name, "dim"), drawn, f"  {found.said}")

    return Fitted(draw)


class _Log:
    """A line without room for its long piece beside the others has that piece below them."""

    def __init__(self, log: Log) -> None:
        self._log = log

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        lines = [[_text(each) for each in line] for line in self._log.lines]
        room = min(options.max_width, BESIDE_COLUMNS) * 2 // 3
        beside = [line for line in lines if sum(each.cell_len for each in line[:-1]) <= room]
        widths = [max(each.cell_len for each in column) for column in zip(*beside, strict=True)]
        for line in lines:
            if line not in beside or sum(widths[:-1]) > room:
                whole = Text("  ").join(line)
                fits = whole.cell_len <= options.max_width
                yield from [whole] if fits else (Text("  ").join(line[:-1]), indented(line[-1]))
                continue
            grid = Table.grid(padding=(0, 2))
            for width in widths[:-1]:
                grid.add_column(no_wrap=True, width=width)
            grid.add_column(overflow="fold")
            grid.add_row(*line)
            yield grid


class _Fitted:
    """Nothing of a table is ever cut off."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        rows = self._rows
        free = options.update(max_width=BOUNDLESS)

        def excess(*omitted: str) -> int:
            drawn = _table(rows, omitted)
            return Measurement.get(console, free, drawn).maximum - options.max_width

        for omitted in ((), rows.wide):
            if excess(*omitted) <= 0:
                yield _table(rows, omitted)
                return
        over = excess(*rows.wide)
        first = max(len(rows.names[0]), *(_text(row[0]).cell_len for row in rows.cells))
        if first - over >= _LEAST_NAME:
            yield _table(rows, rows.wide, first - over)
            return
        for row in rows.cells:
            title = "" if rows.names[0] in rows.left else rows.names[0]
            yield Text(f"{title} " if title else "").append_text(_text(row[0]))
            pairs = zip(rows.names[1:], row[1:], strict=True)
            cells = [
                Text.assemble((name, "dim"), " ", _text(cell))
                for name, cell in pairs
                if cell and name not in rows.wide
            ]
            yield indented(Text(", ").join(cells))


def _table(rows: Rows, omitted: tuple[str, ...] | Any, first: int | None = None) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    kept = [place for place, name in enumerate(rows.names) if name not in omitted]
    for place in kept:
        name = rows.names[place]
        folded = first is not None and place == 0
        table.add_column(
            name,
            justify="left" if name in rows.left else "right",
            no_wrap=not folded,
            overflow="fold",
            width=first if folded else None,
        )
    for row in rows.cells:
        table.add_row(*(_text(row[place]) for place in kept))
    return table


class Fitted:
    """A picture drawn for the terminal's width."""

    def __init__(self, draw: Callable[[int], RenderableType]) -> None:
        self._draw = draw

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        drawn = self._draw(options.max_width)
        yield _text(drawn) if isinstance(drawn, str) else drawn  # rich reads [...] as a style


def fitted(draw: Callable[Concatenate[int, P], RenderableType]) -> Callable[P, Fitted]:
    """Gives a picture that width as its first parameter."""

    @wraps(draw)
    def view(*args: P.args, **named: P.kwargs) -> Fitted:
        return Fitted(lambda columns: draw(columns, *args, **named))

    return view


def indented(found: RenderableType, columns: int = INDENT) -> RenderableType:
    return Padding.indent(_text(found) if isinstance(found, str) else found, columns)


# Curves one line high, made of block characters.


BLOCKS = "▁▂▃▄▅▆▇█"

CURVE_COLUMNS, LEAST_CURVE_COLUMNS = 54, 4
NONE, SOME, ALL = "·", "◦", "●"


def curve(
    values: Sequence[float | None], width: int, *, top: float | None = None, rows: int = 1
) -> str:
    """Numbers as heights, averaged down to `width` characters; spaces where none is known.

    From zero, or the least value if that is negative, to `top`, by default the greatest. Several
    `rows` are lines, the highest first.
    """
    known = [[each for each in part if each is not None] for part in _parts(values, width)]
    means = [sum(part) / len(part) if part else None for part in known]
    found = [mean for mean in means if mean is not None]
    if not found:
        return "\n" * (rows - 1)
    low = min(0.0, *found)
    span = ((max(found) if top is None else top) - low) or 1.0
    last = rows * len(BLOCKS) - 1
    heights = [
        -1 if mean is None else max(0, min(last, round((mean - low) / span * last)))
        for mean in means
    ]
    filled = " " + BLOCKS
    below = [row * len(BLOCKS) for row in reversed(range(rows))]
    return "\n".join(
        "".join(filled[max(0, min(len(BLOCKS), height + 1 - low))] for height in heights)
        for low in below
    )


def marks(completed: Sequence[float | None], width: int) -> str:
    """Marks of evaluations below a curve; the best of several is shown."""
    return "".join(_mark(part) for part in _parts(completed, width))


def _mark(completed: Sequence[float | None]) -> str:
    best = max((share for share in completed if share is not None), default=None)
    if best is None:
        return " "
    if best == 0:
        return NONE
    return ALL if best == 1 else SOME


def _parts(values: Sequence[T], width: int) -> list[Sequence[T]]:
    count = min(len(values), width)
    edges = [round(i * len(values) / count) for i in range(count + 1)] if count else []
    return [values[start:end] for start, end in pairwise(edges)]
