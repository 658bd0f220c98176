"""`dr shell-env`, for scripts/activate.sh."""

import os

import typer

from drcli.base.errors import DrError
from drcli.base.installation import lazy_imports
from drcli.cli.options import text_only
from drcli.cli.working_folder import working_folder

with lazy_imports():
    from drcli.config import shell_variables


EXPERIMENT = "_DR_EXPERIMENT"


@text_only
def shell_env() -> None:
    """Print the settings as lines for `eval` in bash or zsh.

    For bin/activate.sh, which people source instead.

    Example: eval "$(dr shell-env)"
    """
    try:
        change = shell_variables.shell_change(
            working_folder(), os.environ, experiment=os.environ.get(EXPERIMENT, "")
        )
    except DrError as error:  # a line in every new shell is enough; `dr config check` says more
        what, remedy = (text.partition("\n")[0] for text in (str(error), error.remedy))
        typer.echo(f"activate.sh: {what} Try: {remedy}", err=True)
        raise typer.Exit(error.code) from None
    for warning in change.warnings:
        typer.echo(f"activate.sh: {warning}", err=True)
    typer.echo(change.script(), nl=False)
