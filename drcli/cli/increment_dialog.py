"""What both commands that raise a number have in common."""

import shlex
from pathlib import Path


def announce(file: str | Path, before: str, after: str) -> None:
    """Say what is going to be changed, in the words of the reference."""
    from drcli.cli import console

    console.say(f"Configuration file {file} will be updated.")
    console.say(f"Incrementing model from {before} to {after}")


def finish(file: str | Path, backup: str | Path, following: tuple[str, str]) -> None:
    """Say that it is done, what to do next, and how to take it back."""
    from drcli.cli import console

    console.say("Done.")
    console.suggest([following, (shlex.join(["cp", str(backup), str(file)]), "take it back")])
