"""DeepRacer-for-Cloud's commands for logs and processes."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import Absent
from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.log_tail import POLL_S, show_log
from drcli.cli.options import text_only
from drcli.cli.show import show
from drcli.cli.working_folder import settings, working_folder

if TYPE_CHECKING:
    from drcli.run.worker_processes import Process

with lazy_imports():
    from drcli.run import worker_processes


TAIL_LINES = 100
"""The reference: the last five minutes."""

_Wait = Annotated[
    float,
    typer.Option("-w", "--wait", min=0, metavar="SEC", help="Wait SEC seconds for its start."),
]
_Replica = Annotated[
    int,
    typer.Option(
        "-n", "--replica", min=1, metavar="N", help="Number of the simulation worker, from 1."
    ),
]
_Evaluation = Annotated[
    bool, typer.Option("-e", "--evaluation", help="Use the evaluation instead of the training.")
]
_Whole = Annotated[bool, typer.Option("-a", "--all", help="Show the whole log first.")]


@text_only
def logs_sagemaker(wait_s: _Wait = 0.0, whole: _Whole = False) -> None:
    """Follow the trainer's log while the training runs.

    Exits 1 when no training is running; dr-logs trainer shows the log of one that has ended.

    Example: dr-logs-sagemaker -w 15
    """
    _follow(_TRAINER, wait_s, whole=whole)


@text_only
def logs_robomaker(
    wait_s: _Wait = 0.0,
    replica: _Replica = 1,
    evaluation: _Evaluation = False,
    whole: _Whole = False,
) -> None:
    """Follow the log of a simulation worker, or of an evaluation, while it runs.

    Exits 1 when it is not running; dr-logs sim -n 0 shows the log of one that has ended.

    Example: dr-logs-robomaker -n 2
    """
    _follow(_robomaker(replica, evaluation), wait_s, whole=whole)


def find_sagemaker() -> None:
    """Print the process number of the trainer. Exits 1 when no training is running.

    Example: dr-find-sagemaker
    """
    _print(_TRAINER)


def find_robomaker(
    replica: Annotated[
        int | None,
        typer.Option(
            "-n", "--replica", min=1, metavar="N", help="Only this simulation worker, from 1."
        ),
    ] = None,
    evaluation: _Evaluation = False,
) -> None:
    """Print the process numbers of the simulation workers, one per line.

    Exits 1 when none is running.

    Example: dr-find-robomaker -n 1
    """
    _print(_robomaker(replica, evaluation))


def get_robomaker_stats(replica: _Replica = 1) -> None:
    """Show how fast a simulation worker drove in its last iteration.

    Counts all its cars together; 1.0 x is real time. Exits 1 when it is not running.

    Example: dr-get-robomaker-stats -n 2 --json
    """
    wanted = _robomaker(replica)
    found = wanted.find()
    if not found:
        raise wanted.absent()
    show(worker_processes.speed_of(found[0], settings().run))


@dataclass(frozen=True)
class _Wanted:
    """The processes that a command asks for; `replica` counts from 1."""

    title: str
    starter: str
    log: str
    replica: int | None = None
    evaluation: bool = False

    def find(self) -> "list[Process]":
        look = worker_processes.evaluations if self.evaluation else worker_processes.simulations
        if self is _TRAINER:
            look = worker_processes.trainers
        found = look(working_folder(), settings().run_id)
        return found if self.replica is None else found[self.replica - 1 : self.replica]

    def absent(self) -> Absent:
        remedy = f"Start it with `{self.starter}`; `{self.log}` shows the log of the last one."
        return Absent(f"{self.title} is not running.", remedy=remedy)


_TRAINER = _Wanted("Sagemaker", "dr-start-training", "dr-logs trainer")


def _robomaker(replica: int | None, evaluation: bool = False) -> _Wanted:
    title = "Robomaker" if replica is None else f"Robomaker #{replica}"
    if evaluation:
        commands = "dr-start-evaluation -q", "dr-logs evaluation"
    else:
        commands = "dr-start-training", f"dr-logs sim -n {(replica or 1) - 1}"
    return _Wanted(title, *commands, replica, evaluation)


def _follow(wanted: _Wanted, wait_s: float, *, whole: bool) -> None:
    deadline = time.monotonic() + wait_s
    found = wanted.find()
    if not found and wait_s:
        terminal.say(f"Waiting for {wanted.title} to start ...")
    while not found and time.monotonic() < deadline:
        time.sleep(POLL_S)
        found = wanted.find()
    if not found:
        raise wanted.absent()
    show_log(Path(found[0].log), None if whole else TAIL_LINES, lambda: bool(wanted.find()))


def _print(wanted: _Wanted) -> None:
    report = worker_processes.ProcessReport([process for process in wanted.find() if process.alive])
    lines = "\n".join(str(process.pid) for process in report.processes)
    if terminal.as_json or lines:
        terminal.emit(report, lines)
    if not lines:
        raise wanted.absent()
