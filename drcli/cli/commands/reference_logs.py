"""Names of DeepRacer-for-Cloud for logs, processes and speed of trainer and simulation."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from drcli.base.errors import Absent
from drcli.cli import console
from drcli.cli.log_tail import POLL_S, show_log
from drcli.cli.options import AsJson
from drcli.cli.views import summary_view
from drcli.cli.working_folder import settings, working_folder
from drcli.runs import status
from drcli.runs.status import Process, ProcessReport

TAIL_LINES = 100
"""Lines of an existing log that are shown; the reference shows the last five minutes."""

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


def logs_sagemaker(wait_s: _Wait = 0.0, whole: _Whole = False) -> None:
    """Follow the trainer's log while the training runs.

    Exits 1 when no training is running; dr-logs trainer shows the log of one that has ended.

    Example: dr-logs-sagemaker -w 15
    """
    _follow(_trainers, _TRAINER, wait_s, whole=whole)


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

    def look() -> list[Process]:
        return _robomakers(evaluation)[replica - 1 : replica]

    _follow(look, _Wanted.of(replica, evaluation=evaluation), wait_s, whole=whole)


def find_sagemaker(as_json: AsJson = False) -> None:
    """Print the process number of the trainer. Exits 1 when no training is running.

    Example: dr-find-sagemaker
    """
    _print(_trainers(), _TRAINER, as_json=as_json)


def find_robomaker(
    replica: Annotated[
        int | None,
        typer.Option(
            "-n", "--replica", min=1, metavar="N", help="Only this simulation worker, from 1."
        ),
    ] = None,
    evaluation: _Evaluation = False,
    as_json: AsJson = False,
) -> None:
    """Print the process numbers of the simulation workers, one per line.

    Exits 1 when none is running.

    Example: dr-find-robomaker -n 1
    """
    found = _robomakers(evaluation)
    if replica is not None:
        found = found[replica - 1 : replica]
    _print(found, _Wanted.of(replica, evaluation=evaluation), as_json=as_json)


def get_robomaker_stats(replica: _Replica = 1, as_json: AsJson = False) -> None:
    """Show how fast a simulation worker drove in its last iteration.

    Counts all its cars together; 1.0 x is real time. Exits 1 when it is not running.

    Example: dr-get-robomaker-stats -n 2 --json
    """
    found = _robomakers(False)[replica - 1 : replica]
    if not found:
        raise _absent(_Wanted.of(replica))
    report = status.speed_of(found[0], settings().run)
    console.emit(report, summary_view.speed(report), as_json=as_json)


@dataclass(frozen=True)
class _Wanted:
    """What is looked for.

    Attributes:
        title: What the reference calls it.
        starter: The command that starts it.
        log: The command that shows its log, also after its end.
    """

    title: str
    starter: str
    log: str

    @classmethod
    def of(cls, replica: int | None, *, evaluation: bool = False) -> "_Wanted":
        """A simulation worker from 1 on, or any of them where no number is given."""
        title = "Robomaker" if replica is None else f"Robomaker #{replica}"
        if evaluation:
            return cls(title, "dr-start-evaluation -q", "dr-logs evaluation")
        return cls(title, "dr-start-training", f"dr-logs sim -n {(replica or 1) - 1}")


_TRAINER = _Wanted("Sagemaker", "dr-start-training", "dr-logs trainer")


def _trainers() -> list[Process]:
    return status.trainers(working_folder(), settings().run_id)


def _robomakers(evaluation: bool) -> list[Process]:
    look = status.evaluations if evaluation else status.simulations
    return look(working_folder(), settings().run_id)


def _follow(
    look: Callable[[], list[Process]], wanted: "_Wanted", wait_s: float, *, whole: bool
) -> None:
    """Show a worker's log until its run ends, or until Ctrl-C.

    Args:
        look: Finds the worker.
        wanted: What is looked for.
        wait_s: Longest time to wait for its start.
        whole: Whether to show the whole log first.
    """
    deadline = time.monotonic() + wait_s
    found = look()
    if not found and wait_s:
        console.say(f"Waiting for {wanted.title} to start ...")
    while not found and time.monotonic() < deadline:
        time.sleep(POLL_S)
        found = look()
    if not found:
        raise _absent(wanted)
    show_log(Path(found[0].log), None if whole else TAIL_LINES, lambda: bool(look()))


def _print(found: list[Process], wanted: "_Wanted", *, as_json: bool) -> None:
    """Print the process numbers of the workers that are alive; fail if there are none."""
    report = ProcessReport([process for process in found if process.alive])
    lines = "\n".join(str(process.pid) for process in report.processes)
    if as_json or lines:
        console.emit(report, lines, as_json=as_json)
    if not lines:
        raise _absent(wanted)


def _absent(wanted: "_Wanted") -> Absent:
    return Absent(
        f"{wanted.title} is not running.",
        remedy=f"Start it with `{wanted.starter}`; `{wanted.log}` shows the log of the last one.",
    )
