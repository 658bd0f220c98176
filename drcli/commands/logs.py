"""`dr logs`."""

import re
import time
from typing import Annotated

import typer

from drcli.commands.folder import settings, working_folder

TAIL_LINES = 20
POLL_S = 0.3
OTHERS = ("trainer", "supervisor", "evaluation")
"""Logs beside those of the simulation workers."""

_STARTS = ("a training with `dr-start-training`", "an evaluation with `dr-evaluate`")


def logs(
    worker: Annotated[
        str, typer.Argument(metavar="WHO", help="sim, trainer, supervisor or evaluation.")
    ] = "sim",
    number: Annotated[
        int, typer.Option("-n", "--number", help="Which simulation worker, from 0.", min=0)
    ] = 0,
    follow: Annotated[bool, typer.Option("-f", "--follow", help="Go on until Ctrl-C.")] = False,
    whole: Annotated[
        bool, typer.Option("-a", "--all", help="Show all of it, not just the last lines.")
    ] = False,
) -> None:
    """Show what a worker has to say.

    Example: dr-logs trainer -f
    """
    from drcli import console
    from drcli.commands.tail import Tail
    from drcli.errors import SettingsError
    from drcli.runs.logs import log_file

    path = log_file(settings(), working_folder(), _name(worker, number))
    if not path.exists():
        if not follow:
            raise SettingsError(
                f"There is no log yet: {path}.",
                remedy=f"Start {_STARTS[worker == 'evaluation']}, or wait for it with -f.",
            )
        console.say(f"Waiting for {path} ...")
    tail = Tail(path, None if whole else TAIL_LINES)
    try:
        console.write(tail.read(unfinished=not follow))
        while follow:
            time.sleep(POLL_S)
            console.write(tail.read())
    except KeyboardInterrupt:  # the way to end -f is no failure
        return


def _name(worker: str, number: int) -> str:
    """The name of the log that is meant."""
    if worker == "sim":
        return f"sim-{number}"
    if worker in OTHERS or re.fullmatch(r"sim-\d+", worker):
        return worker
    raise typer.BadParameter(f"'{worker}' is none of sim, {', '.join(OTHERS)}.")
