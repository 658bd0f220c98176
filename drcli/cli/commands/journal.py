"""`dr journal`."""

from typing import TYPE_CHECKING, Annotated

import typer

from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.show import show
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    pass


def journal(
    model: Annotated[
        str | None,
        typer.Argument(metavar="MODEL", help="Prefix of a model; that of run.env if left out."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show what happened to a model: starts, machines, notices, faults, and how each start ended.

    Contains the starts on all machines, from the bucket, and the notes of `dr-note`.

    Example: dr-journal
    """
    from drcli.run.journal import journal_of

    report = journal_of(settings(), model)
    console.warn(*report.damaged)
    show(report, as_json=as_json)
