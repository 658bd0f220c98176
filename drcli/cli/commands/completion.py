"""`dr completion`: lets the Tab key finish command lines."""

from typing import Annotated, Literal

import typer

from drcli.cli.options import AsJson

app = typer.Typer(
    no_args_is_help=True,
    help="Let the Tab key finish commands and their values.\n\nExample: dr-completion install",
)

_Shell = Annotated[
    Literal["bash", "zsh", "fish"] | None,
    typer.Argument(
        metavar="[SHELL]",
        help="bash, zsh or fish; taken from $SHELL when left out.",
        show_default=False,
    ),
]


@app.command()
def show(shell: _Shell = None) -> None:
    """Print what a shell has to run.

    Example: source <(dr completion show bash)
    """
    import os

    from drcli.cli import console
    from drcli.cli.completion.install import shell_of
    from drcli.cli.completion.scripts import script

    console.write(script(shell or shell_of(os.environ)))


@app.command()
def install(shell: _Shell = None, as_json: AsJson = False) -> None:
    """Let every new shell know how to finish the dr commands.

    Writes a file of its own, and one line into ~/.bashrc or ~/.zshrc.

    Example: dr-completion install
    """
    import os

    from drcli.cli import console
    from drcli.cli.completion.install import install, shell_of

    done = install(shell or shell_of(os.environ), os.environ)
    if as_json:
        console.emit(done, "", as_json=True)
        return
    console.say(f"New {done.shell} shells finish the dr commands from now on ({done.script}).")
