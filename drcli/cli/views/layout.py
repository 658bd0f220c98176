"""How views use the columns of a terminal: rows, indents, and what is drawn to measure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from drcli.cli.console import BOUNDLESS

INDENT = 2
"""Columns before what belongs to the line above it."""

_LEAST_NAME = 24
"""Columns that the first cell of a row may be folded to."""

Cell = str | Text


class Fitted:
    """A view that is drawn for the columns there are.

    Args:
        draw: Takes the number of columns.
    """

    def __init__(self, draw: Callable[[int], RenderableType]) -> None:
        self._draw = draw

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw it."""
        yield self._draw(options.max_width)


@dataclass(frozen=True)
class Rows:
    """A table as far as its rows fit a line; else the first cell of each, the others below it.

    Nothing is ever cut off.

    Attributes:
        names: Of the columns. The first one tells the rows apart.
        cells: A cell for each column, by row.
        left: Names of the columns that hold words; the others hold numbers.
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
            yield self._head(row[0])
            pairs = zip(self.names[1:], row[1:], strict=True)
            told = [Text.assemble((name, "dim"), " ", cell) for name, cell in pairs if cell]
            yield indented(Text(", ").join(told))

    def _table(self, first: int | None = None) -> Table:
        """The rows as a table, its first column that wide and all others as wide as they need."""
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

    def _head(self, cell: Cell) -> Text:
        name = self.names[0]
        return Text.assemble(cell) if name in self.left else Text.assemble(f"{name} ", cell)


def indented(text: Cell, columns: int = INDENT) -> RenderableType:
    """Text that is broken at the edge of the terminal, below what it belongs to."""
    return Padding.indent(Text.assemble(text), columns)
