"""`dr logs`."""

import re
import time
from typing import Annotated

import typer

from drcli.base.errors import Absent
from drcli.cli.working_folder import settings, working_folder

TAIL_LINES = 20
POLL_S = 0.3
OTHERS = ("trainer", "supervisor", "evaluation")
"""Logs beside those of the simulation workers."""

ANY_SIM = "sim"
"""Stands for the simulation worker that -n names."""


def logs(
    worker: Annotated[
        str, typer.Argument(metavar="WHO", help="sim, trainer, supervisor or evaluation.")
    ] = ANY_SIM,
    number: Annotated[
        int, typer.Option("-n", "--number", help="Which simulation worker, from 0.", min=0)
    ] = 0,
    follow: Annotated[bool, typer.Option("-f", "--follow", help="Go on until Ctrl-C.")] = False,
    whole: Annotated[
        bool, typer.Option("-a", "--all", help="Show all of it, not just the last lines.")
    ] = False,
) -> None:
    """Show what a worker has to say.

    Exits 1 where there is no log yet.

    Example: dr-logs trainer -f
    """
    from drcli.cli import console
    from drcli.cli.log_tail import Tail, older
    from drcli.runs.run_logs import log_file

    loaded, name = settings(), _name(worker, number)
    path = log_file(working_folder(), loaded.model_prefix, name)
    if not path.exists():
        if not follow:
            raise Absent(f"There is no log yet: {path}.", remedy=_remedy(name, loaded.workers))
        console.say(f"Waiting for {path} ...")
    tail = Tail(path, None if whole else TAIL_LINES)
    try:
        for piece in older(path) if whole else ():
            console.write(piece)
        while text := tail.read(unfinished=not follow):
            console.write(text)
        while follow:
            time.sleep(POLL_S)
            console.write(tail.read(), followed=True)
    except KeyboardInterrupt:  # the way to end -f is no failure
        return


def _name(worker: str, number: int) -> str:
    """The name of the log that is meant."""
    if worker == ANY_SIM:
        return f"sim-{number}"
    if worker in OTHERS or re.fullmatch(r"sim-\d+", worker):
        return worker
    raise typer.BadParameter(f"'{worker}' is none of {', '.join((ANY_SIM, *OTHERS))}.")


def _remedy(name: str, workers: int) -> str:
    """What to do about the log of that name, in a training on so many simulation workers."""
    if name == "evaluation":
        return "Start an evaluation with `dr-evaluate`, or wait for one with -f."
    kind, _, number = name.partition("-")
    if kind == "sim" and int(number) >= workers:
        return f"Choose a worker from 0 to {workers - 1}: DR_WORKERS is {workers}."
    return "Start a training with `dr-start-training`, or wait for one with -f."
