"""`dr logs`."""

import re
from typing import Annotated

import typer

from drcli.base.errors import Absent
from drcli.cli import candidates, console
from drcli.cli.log_tail import show_log
from drcli.cli.working_folder import settings, working_folder

TAIL_LINES = 20


def logs(
    worker: Annotated[
        str,
        typer.Argument(
            metavar="WHO",
            help="sim, trainer, supervisor or evaluation.",
            autocompletion=candidates.workers,
        ),
    ] = "sim",
    number: Annotated[
        int,
        typer.Option(
            "-n", "--number", metavar="N", help="Number of the sim worker, from 0.", min=0
        ),
    ] = 0,
    follow: Annotated[
        bool, typer.Option("-f", "--follow", help="Follow the log until Ctrl-C.")
    ] = False,
    whole: Annotated[
        bool, typer.Option("-a", "--all", help="Show the whole log instead of the last lines.")
    ] = False,
) -> None:
    """Show a worker's log.

    Exits 1 when there is no log yet.

    Example: dr-logs trainer -f
    """
    from drcli.runs.run_logs import log_file

    loaded, name = settings(), _name(worker, number)
    path = log_file(working_folder(), loaded.model_prefix, name)
    if not path.exists():
        if not follow:
            raise Absent(f"There is no log yet: {path}.", remedy=_remedy(name, loaded.workers))
        console.say(f"Waiting for {path} ...")
    show_log(path, None if whole else TAIL_LINES, lambda: follow)


def _name(worker: str, number: int) -> str:
    if worker == "sim":
        return f"sim-{number}"
    if worker in candidates.LOGS or re.fullmatch(r"sim-\d+", worker):
        return worker
    raise typer.BadParameter(f"'{worker}' is not one of {', '.join(candidates.LOGS)}.")


def _remedy(name: str, workers: int) -> str:
    if name == "evaluation":
        return "Start an evaluation with `dr-evaluate`, or add -f to wait for one."
    kind, _, number = name.partition("-")
    if kind == "sim" and int(number) >= workers:
        there = "is only worker 0" if workers == 1 else f"are workers 0 to {workers - 1}"
        return f"There {there}: DR_WORKERS is {workers}."
    return "Start a training with `dr-start-training`, or add -f to wait for one."
