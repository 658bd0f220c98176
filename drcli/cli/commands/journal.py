"""`dr journal`."""

from typing import Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.show import show
from drcli.cli.working_folder import settings

with lazy_imports():
    from drcli.run import journal as run_journal


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
    terminal.warn(*report.damaged)
    show(report)
