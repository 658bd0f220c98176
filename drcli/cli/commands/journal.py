"""`dr journal`."""

import time
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drcli.base.installation import lazy_imports
from drcli.cli import console
from drcli.cli.views.layout import fitted, indented
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.run.journal import JournalReport

with lazy_imports():
    from drcli.run import journal as run_journal

# Shows a model's journal.


WIDE = 80
KIND_STYLES = {
    "start": "bold cyan",
    "notice": "bold yellow",
    "fault": "red",
    "recovery": "green",
    "stage": "cyan",
    "end": "bold",
}


@fitted
def show_journal(columns: int, report: "JournalReport") -> RenderableType:
    if not report.events:
        return Text(f"{report.model} has no journal: it was never trained, or by an old version.")
    if columns < WIDE:
        rows: list[RenderableType] = [Text(report.model, style="bold")]
        for event in report.events:
            styled = (event.kind, KIND_STYLES.get(event.kind, ""))
            rows.append(Text.assemble((_moment(event.at), "dim"), " ", styled))
            rows.append(indented(_printable(event.text)))
        return Group(*rows)
    table = Table.grid(padding=(0, 1))
    table.add_column(no_wrap=True, style="dim")
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for event in report.events:
        kind = Text(event.kind, style=KIND_STYLES.get(event.kind, ""))
        table.add_row(_moment(event.at), kind, Text(_printable(event.text)))
    return Group(Text(report.model, style="bold"), table)


def _moment(at: float) -> str:
    with suppress(ValueError, OverflowError, OSError):
        return time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(at))
    return "?"


def _printable(text: str) -> str:
    """Without what would control a terminal."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def journal(
    model: Annotated[
        str | None,
        typer.Argument(metavar="MODEL", help="Prefix of a model; that of run.env if left out."),
    ] = None,
) -> None:
    """Show what happened to a model: starts, machines, notices, faults, and how each start ended.

    Contains the starts on all machines, from the bucket, and the notes of `dr-note`.

    Example: dr-journal
    """
    report = run_journal.journal_of(settings(), model)
    console.warn(*report.damaged)
    console.emit(report, show_journal(report))
