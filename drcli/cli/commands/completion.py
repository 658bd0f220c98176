"""`dr completion`."""

import os
from typing import Annotated

import typer

from drcli.cli import completion, terminal
from drcli.cli.options import text_only

app = typer.Typer(
    no_args_is_help=True,
    help="Make the Tab key complete commands and their values.\n\nExample: dr-completion install",
)

_Shell = Annotated[
    completion.Shell | None,
    typer.Argument(
        metavar="SHELL",
        help="bash, zsh or fish; taken from $SHELL if left out.",
        show_default=False,
    ),
]


@app.command()
@text_only
def show(shell: _Shell = None) -> None:
    """Print the script that a shell has to run.

    Example: source <(dr completion show bash)
    """
    terminal.write(completion.script(shell or completion.shell_of(os.environ)))


@app.command()
def install(shell: _Shell = None) -> None:
    """Set up completion in every new shell.

    Writes one file, and adds one line to ~/.bashrc or ~/.zshrc.

    Example: dr-completion install
    """
    done = completion.install(shell or completion.shell_of(os.environ), os.environ)
    terminal.emit(done, None)
    terminal.say(f"New {done.shell} shells now complete the dr commands ({done.script}).")
