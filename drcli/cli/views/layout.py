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
"""Indent of what belongs to the line above it."""

_LEAST_NAME = 24
"""Narrowest width to fold the first cell of a row to."""

Cell = str | Text

P = ParamSpec("P")


class Fitted:
    """A view that `draw` draws for the number of columns of the terminal."""

    def __init__(self, draw: Callable[[int], RenderableType]) -> None:
        self._draw = draw

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw it."""
        drawn = self._draw(options.max_width)
        yield (
            Text(drawn) if isinstance(drawn, str) else drawn
        )  # rich reads [...] in a str as a style


def fitted(draw: Callable[Concatenate[int, P], RenderableType]) -> Callable[P, Fitted]:
    """Let a view whose first parameter is the number of columns get the terminal's width."""

    @wraps(draw)
    def view(*args: P.args, **named: P.kwargs) -> Fitted:
        return Fitted(lambda columns: draw(columns, *args, **named))

    return view


@dataclass(frozen=True)
class Rows:
    """A table if its rows fit the terminal; else a list, the other cells below the first one.

    Nothing is ever cut off.

    Attributes:
        names: Names of the columns. The first column names the row.
        cells: For each row, a cell for each column.
        left: Names of the columns with words, which are aligned left; numbers are aligned right.
    """

    names: Sequence[str]
    cells: Sequence[Sequence[Cell]]
    left: Sequence[str] = ()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw it."""
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
        """The rows as a table; `first` is the width of its first column."""
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
    """A number with its word, such as `1 file` and `2 files`."""
    return f"{number:,} {word}" + ("" if number == 1 else "s")


def indented(text: Cell, columns: int = INDENT) -> RenderableType:
    """Indented text, folded at the edge of the terminal."""
    return Padding.indent(Text.assemble(text), columns)
