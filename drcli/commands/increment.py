"""What both commands that raise a number have in common."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

Delimiter = Annotated[
    str | None,
    typer.Option("-d", "--delimiter", help="What stands before the number, as - or _."),
]


def checked(delimiter: str | None) -> str | None:
    """A delimiter that can be told from the number behind it."""
    if delimiter is not None and (not delimiter or delimiter[-1].isdigit()):
        raise typer.BadParameter("-d takes what stands before a number, as - or _.")
    return delimiter


def announce(file: str | Path, before: str, after: str) -> None:
    """Say what is going to be changed, in the words of the reference."""
    from drcli import console

    console.say(f"Configuration file {file} will be updated.")
    console.say(f"Incrementing model from {before} to {after}")


def finish(file: str | Path, backup: str | Path, following: tuple[str, str]) -> None:
    """Say that it is done, what to do next, and how to take it back."""
    from drcli import console

    console.say("Done.")
    console.suggest([following, (shlex.join(["cp", str(backup), str(file)]), "take it back")])
