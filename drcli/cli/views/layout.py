"""Fits views to the width of a terminal."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Concatenate, ParamSpec

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from drcli.cli.console import BOUNDLESS

INDENT = 2
_LEAST_NAME = 24
Cell = str | Text

P = ParamSpec("P")


class Fitted:
    """A view drawn for the terminal's width."""

    def __init__(self, draw: Callable[[int], RenderableType]) -> None:
        self._draw = draw

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        drawn = self._draw(options.max_width)
        yield (
            Text(drawn) if isinstance(drawn, str) else drawn
        )  # rich reads [...] in a str as a style


def fitted(draw: Callable[Concatenate[int, P], RenderableType]) -> Callable[P, Fitted]:
    """Gives a view that width as its first parameter."""

    @wraps(draw)
    def view(*args: P.args, **named: P.kwargs) -> Fitted:
        return Fitted(lambda columns: draw(columns, *args, **named))

    return view


@dataclass(frozen=True)
class Rows:
    """A table if its rows fit the terminal; else a list. Nothing is ever cut off."""

    names: Sequence[str]
    cells: Sequence[Sequence[Cell]]
    left: Sequence[str] = ()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        table = self._table()
        free = options.update(max_width=BOUNDLESS)
        excess = Measurement.get(console, free, table).maximum - options.max_width
        if excess <= 0:
            yield table
            return
        first = max(len(self.names[0]), *(Text.assemble(row[0]).cell_len for row in self.cells))
        if first - excess >= _LEAST_NAME:
            yield self._table(first - excess)
            return
        for row in self.cells:
            name = Text(f"{self.names[0]} " if self.names[0] not in self.left else "")
            yield name.append_text(Text.assemble(row[0]))
            pairs = zip(self.names[1:], row[1:], strict=True)
            cells = [Text.assemble((name, "dim"), " ", cell) for name, cell in pairs if cell]
            yield indented(Text(", ").join(cells))

    def _table(self, first: int | None = None) -> Table:
        table = Table(box=None, pad_edge=False, header_style="dim")
        for name in self.names:
            folded = first is not None and name == self.names[0]
            table.add_column(
                name,
                justify="left" if name in self.left else "right",
                no_wrap=not folded,
                overflow="fold",
                width=first if folded else None,
            )
        for row in self.cells:
            table.add_row(*map(Text.assemble, row))
        return table


def counted(number: int, word: str) -> str:
    return f"{number:,} {word}" + ("" if number == 1 else "s")


def indented(text: Cell, columns: int = INDENT) -> RenderableType:
    return Padding.indent(Text.assemble(text), columns)
