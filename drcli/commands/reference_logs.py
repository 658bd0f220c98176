"""The reference's names for logs, processes and speed of trainer and simulation workers."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.commands.folder import settings, working_folder
from drcli.commands.options import AsJson
from drcli.errors import DrError

if TYPE_CHECKING:
    from drcli.runs.processes import Process

TAIL_LINES = 100
"""Of a log that is there already; the reference shows the last five minutes."""

POLL_S = 0.3

_Wait = Annotated[
    float, typer.Option("-w", "--wait", min=0, metavar="SEC", help="Wait so long for a start.")
]
_Replica = Annotated[
    int, typer.Option("-n", "--replica", min=1, help="Which simulation worker, from 1.")
]
_Evaluation = Annotated[
    bool, typer.Option("-e", "--evaluation", help="That of an evaluation instead.")
]
_Whole = Annotated[bool, typer.Option("-a", "--all", help="Show all of it first.")]


class NotRunning(DrError):
    """The process that was asked for is not there. Its exit code is the reference's, 1."""

    final = True


def logs_sagemaker(wait_s: _Wait = 0.0, whole: _Whole = False) -> None:
    """Follow the trainer's log while the training runs.

    Exits 1 where no training runs; dr-logs trainer shows the log of one that has ended.

    Example: dr-logs-sagemaker -w 15
    """
    _follow(_trainers, "Sagemaker", wait_s, whole=whole)


def logs_robomaker(
    wait_s: _Wait = 0.0,
    replica: _Replica = 1,
    evaluation: _Evaluation = False,
    whole: _Whole = False,
) -> None:
    """Follow the log of a simulation worker, or of an evaluation, while it runs.

    Exits 1 where it does not run; dr-logs sim -n 0 shows the log of one that has ended.

    Example: dr-logs-robomaker -n 2
    """

    def look() -> "list[Process]":
        return _robomakers(evaluation)[replica - 1 : replica]

    _follow(look, f"Robomaker #{replica}", wait_s, whole=whole)


def find_sagemaker(as_json: AsJson = False) -> None:
    """Print the process number of the trainer. Exits 1 where no training runs.

    Example: dr-find-sagemaker
    """
    _print(_trainers(), "Sagemaker", as_json=as_json)


def find_robomaker(
    replica: Annotated[
        int | None,
        typer.Option("-n", "--replica", min=1, help="Only this simulation worker, from 1."),
    ] = None,
    evaluation: _Evaluation = False,
    as_json: AsJson = False,
) -> None:
    """Print the process numbers of the simulation workers, one a line.

    Exits 1 where none runs.

    Example: dr-find-robomaker -n 1
    """
    found = _robomakers(evaluation)
    if replica is None:
        _print(found, "Robomaker", as_json=as_json)
    else:
        _print(found[replica - 1 : replica], f"Robomaker #{replica}", as_json=as_json)


def get_robomaker_stats(replica: _Replica = 1, as_json: AsJson = False) -> None:
    """Show how fast a simulation worker drove in its newest iteration.

    All its cars together; 1.0 x would be real time. Exits 1 where it does not run.

    Example: dr-get-robomaker-stats -n 2 --json
    """
    from drcli import console, views_everyday
    from drcli.runs.speed import speed_of

    found = _robomakers(False)[replica - 1 : replica]
    if not found:
        raise _not_running(f"Robomaker #{replica}")
    report = speed_of(found[0], settings(), working_folder())
    console.emit(report, views_everyday.speed(report), as_json=as_json)


def _trainers() -> "list[Process]":
    from drcli.runs.processes import trainers

    return trainers(settings(), working_folder())


def _robomakers(evaluation: bool) -> "list[Process]":
    from drcli.runs.processes import evaluations, simulations

    look = evaluations if evaluation else simulations
    return look(settings(), working_folder())


def _follow(look: "Callable[[], list[Process]]", title: str, wait_s: float, *, whole: bool) -> None:
    """Show a worker's log until its run has ended or Ctrl-C comes.

    Args:
        look: Finds the worker.
        title: What the reference calls it.
        wait_s: How long it may take to start.
        whole: Whether to begin with all of the log.
    """
    from drcli import console
    from drcli.commands.tail import Tail

    deadline = time.monotonic() + wait_s
    found = look()
    if not found and wait_s:
        console.say(f"Waiting for {title} to start ...")
    while not found and time.monotonic() < deadline:
        time.sleep(POLL_S)
        found = look()
    if not found:
        raise _not_running(title)
    tail = Tail(Path(found[0].log), None if whole else TAIL_LINES)
    try:
        while found:
            console.write(tail.read())
            time.sleep(POLL_S)
            found = look()
        console.write(tail.read(unfinished=True))
    except KeyboardInterrupt:  # the way to end it is no failure
        return


def _print(found: "list[Process]", title: str, *, as_json: bool) -> None:
    """Process numbers of the workers that live; a failure where there are none."""
    from drcli import console
    from drcli.runs.processes import ProcessReport

    report = ProcessReport([process for process in found if process.alive])
    lines = "\n".join(str(process.pid) for process in report.processes)
    if as_json or lines:
        console.emit(report, lines, as_json=as_json)
    if not lines:
        raise _not_running(title)


def _not_running(title: str) -> NotRunning:
    return NotRunning(
        f"{title} is not running.",
        remedy="`dr-summary` tells what runs, `dr-logs` shows what the last one said.",
    )
