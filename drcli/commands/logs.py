"""`dr logs`."""

import time
from pathlib import Path
from typing import Annotated

import typer

from drcli.commands.folder import settings, working_folder

TAIL_LINES = 20
POLL_S = 0.3


def logs(
    worker: Annotated[str, typer.Argument(help="sim, trainer, supervisor or evaluation.")] = "sim",
    number: Annotated[
        int, typer.Option("-n", "--number", help="Which simulation worker, from 0.", min=0)
    ] = 0,
    follow: Annotated[bool, typer.Option("-f", "--follow", help="Go on until Ctrl-C.")] = False,
    whole: Annotated[bool, typer.Option("-a", "--all", help="Show all of it.")] = False,
) -> None:
    """Show the log of a worker.

    Example: dr-logs trainer -f
    """
    from drcli import console
    from drcli.runs.logs import log_file

    name = f"sim-{number}" if worker == "sim" else worker
    known = ("trainer", "supervisor", "evaluation")
    if name not in known and not name.startswith("sim-"):
        raise typer.BadParameter(f"'{worker}' is none of sim, {', '.join(known)}.")
    path = log_file(settings(), working_folder(), name)
    if not path.exists():
        if not follow:
            console.say(f"There is no log yet: {path}. Start with `dr-start-training`.")
            raise typer.Exit(1)
        console.say(f"Waiting for {path} ...")
    try:
        show(path, whole=whole, follow=follow)
    except KeyboardInterrupt:
        return


def show(path: Path, *, whole: bool, follow: bool) -> None:
    """Print a log file's end, or all of it, and what is added to it."""
    while follow and not path.exists():
        time.sleep(POLL_S)
    position = 0
    with path.open(encoding="utf-8", errors="replace") as file:
        lines = file.readlines()
        position = file.tell()
    print("".join(lines if whole else lines[-TAIL_LINES:]), end="", flush=True)
    while follow:
        time.sleep(POLL_S)
        if path.stat().st_size < position:  # started anew
            position = 0
        with path.open(encoding="utf-8", errors="replace") as file:
            file.seek(position)
            print(file.read(), end="", flush=True)
            position = file.tell()
