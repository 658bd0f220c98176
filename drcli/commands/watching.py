"""Stays with a training: a live display on a terminal, a line an iteration elsewhere."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from drcli import console, views

if TYPE_CHECKING:
    from drcli.config import Settings
    from drcli.runs.report import RunReport

POLL_S = 0.5

NEXT = [
    ("dr-logs trainer -f", "follow the learner"),
    ("dr-status", "how far the car gets"),
    ("dr-stop-training", "stop; nothing is lost"),
]
"""What somebody may want to do after a start."""


def until_the_end(settings: "Settings", folder: Path, *, live: bool) -> int | None:
    """Watch until the training ends.

    Returns:
        The exit code of the training, or None when the watcher left before its end.
    """
    try:
        return _display(settings, folder) if live else _print_lines(settings, folder)
    except KeyboardInterrupt:
        return None


@contextmanager
def lines(settings: "Settings", folder: Path) -> Iterator[None]:
    """Print a line an iteration while the training runs in this very process."""
    stop = threading.Event()
    printer = threading.Thread(
        target=_print_lines, args=(settings, folder, stop), name="progress", daemon=True
    )
    printer.start()
    try:
        yield
    finally:
        stop.set()
        printer.join(timeout=5.0)


def log(settings: "Settings", folder: Path, worker: str) -> None:
    """Follow a log until Ctrl-C."""
    from drcli.commands.logs import show
    from drcli.runs.logs import log_file

    try:
        show(log_file(settings, folder, worker), whole=False, follow=True)
    except KeyboardInterrupt:
        console.say("Detached; the training goes on.")


def _inspect(settings: "Settings", folder: Path) -> "RunReport":
    from drcli.runs.status import inspect

    return inspect(settings, folder)


def _display(settings: "Settings", folder: Path) -> int:
    from rich.live import Live

    began = time.time()
    report = _inspect(settings, folder)
    with Live(
        views.live(report, began), console=console.err, auto_refresh=False, transient=True
    ) as display:
        while not _is_over(report):
            time.sleep(POLL_S)
            report = _inspect(settings, folder)
            display.update(views.live(report, began), refresh=True)
    console.err.print(views.run(report))
    return _code(report)


def _print_lines(settings: "Settings", folder: Path, stop: threading.Event | None = None) -> int:
    """A line for every iteration, until the end or until told to stop."""
    shown = len(_inspect(settings, folder).history)
    while True:
        last_look = stop is not None and stop.is_set()
        report = _inspect(settings, folder)
        # The newest iteration waits for its evaluation, which arrives with the next one.
        ready = report.history if _is_over(report) or last_look else report.history[:-1]
        for record in ready[shown:]:
            console.say(views.iteration_line(record))
        shown = max(shown, len(ready))
        if last_look or (stop is None and _is_over(report)):
            return _code(report)
        time.sleep(POLL_S)


def _is_over(report: "RunReport") -> bool:
    return report.state not in ("starting", "running")


def _code(report: "RunReport") -> int:
    """The training's exit code; a run whose supervisor vanished counts as a dead worker."""
    return report.exit_code if report.exit_code is not None else 5
