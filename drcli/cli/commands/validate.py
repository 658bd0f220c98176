"""`dr validate`."""

from typing import Annotated

import typer

from drcli.base.errors import SettingsError
from drcli.cli.options import AsJson
from drcli.cli.working_folder import working_folder


def validate(
    as_json: AsJson = False,
    console_compatible: Annotated[
        bool,
        typer.Option(
            "--console-compatible", help="Refuse what a DeepRacer console would refuse as well."
        ),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Exit 0 even with errors.")] = False,
) -> None:
    """Check settings, your three files, the bucket and this machine, by rule.

    Everything that is wrong is reported at once, with rule, place and remedy; docs/validation.md
    lists the rules. Nothing is changed; the local S3 server is started where it does not run.
    Exits 3 when a training could not start.

    Example: dr-validate --console-compatible
    """
    from drcli.checks import validate as everything
    from drcli.cli import console
    from drcli.cli.views import problems_view

    folder = working_folder()
    with console.waiting(f"Checking {folder} ..."):
        report = everything.validate(folder, console_compatible=console_compatible)
    console.emit(report, problems_view.report(report), as_json=as_json)
    if not report.ok and not force:
        raise typer.Exit(SettingsError.code)
