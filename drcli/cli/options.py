"""Options that mean the same wherever they stand."""

from typing import Annotated

import typer


def _no_number(delimiter: str | None) -> str | None:
    """Refuse what would run into the number behind it."""
    if delimiter is not None and (not delimiter or delimiter[-1].isdigit()):
        raise typer.BadParameter("-d takes what stands before a number, as - or _.")
    return delimiter


AsJson = Annotated[bool, typer.Option("--json", help="One JSON object on the last line of stdout.")]
Force = Annotated[bool, typer.Option("-f", "--force", "--yes", help="Ask nothing.")]
DryRun = Annotated[bool, typer.Option("-d", "--dry-run", help="Only say what would be done.")]
Delimiter = Annotated[
    str | None,
    typer.Option(
        "-d",
        "--delimiter",
        help="What stands before the number, as - or _.",
        callback=_no_number,
    ),
]
