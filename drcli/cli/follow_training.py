"""Follows a running training: live, as lines, or by its logs."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.live import Live

from drcli.base.errors import WorkerDied
from drcli.base.installation import lazy_imports
from drcli.cli import terminal, training_display
from drcli.cli.log_tail import Tail

if TYPE_CHECKING:
    from drcli.config.run_config import RunConfig
    from drcli.records.iteration import IterationRecord
    from drcli.run.status import RunReport

with lazy_imports():
    from drcli.model import history
    from drcli.run import status

POLL_S = 1.0
NEXT = [
    ("dr-attach", "show the display again"),
    ("dr-logs trainer -f", "follow the trainer's log"),
    ("dr-status", "show the progress"),
    ("dr-stop-training", "stop; what was learned is kept"),
]
_OF_THIS_MACHINE = ("dr-logs trainer -f", "dr-stop-training")

Show = Callable[["RunReport"], None]
Display = AbstractContextManager[Show]


def follow(config: "RunConfig", display: Display, prefix: str) -> int:
    """The exit code of the training, or 130 if it goes on; `prefix`: as in `end`."""
    last = until_the_end(config, display)
    if last is not None and is_over(last):
        return end(last, prefix)
    terminal.say("Detached; the training continues.")
    here = last is None or last.pid is not None
    terminal.suggest([each for each in NEXT if here or each[0] not in _OF_THIS_MACHINE])
    return 130


def until_the_end(config: "RunConfig", display: Display) -> "RunReport | None":
    """The newest report at the end, or at Ctrl-C or a closed pipe; None before the first."""
    report = None
    with suppress(KeyboardInterrupt), display as show:
        for report in _reports(config):
            show(report)
            if terminal.reader_has_left():
                break
    return report


@contextmanager
def meanwhile(config: "RunConfig", display: Display) -> Iterator[None]:
    """Watch from a thread while the training runs in this process."""
    stop = threading.Event()

    def watch() -> None:
        for report in _reports(config, stop):
            show(report)

    with display as show:
        watcher = threading.Thread(target=watch, name="watcher", daemon=True)
        watcher.start()
        try:
            yield
        finally:
            stop.set()
            watcher.join(timeout=5.0)


@contextmanager
def live(*, verbose: bool) -> Iterator[Show]:
    console = terminal.err
    with Live(console=console, auto_refresh=False) as screen:
        yield lambda report: screen.update(
            training_display.live(report, time.time(), console.height, verbose=verbose),
            refresh=True,
        )


def suitable(config: "RunConfig", *, verbose: bool, screen: bool = True) -> Display:
    """Live on a terminal, if there is a `screen` for it; else lines of what comes from now on."""
    if screen and terminal.is_live():
        return live(verbose=verbose)
    return lines(status.inspect(config).history, verbose=verbose)


def lines(before: "Sequence[IterationRecord]", *, verbose: bool) -> Display:
    """Every iteration, except those `before`, of earlier starts."""
    # An iteration that is repeated has the same number and another time.
    printed = {(record.iteration, record.elapsed_s) for record in before}
    warned = False

    def show(report: "RunReport") -> None:
        nonlocal warned
        # The newest iteration waits for its evaluation, which comes with the next one.
        ready = report.history if is_over(report) else report.history[:-1]
        for record in ready:
            if (record.iteration, record.elapsed_s) not in printed:
                printed.add((record.iteration, record.elapsed_s))
                terminal.say(training_display.line(record, verbose=verbose))
        if report.warning and not warned:
            terminal.warn(f"{report.warning}.")
        warned = bool(report.warning)

    return nullcontext(show)


def logs(paths: Mapping[str, Path]) -> Display:
    """New lines of the workers' logs."""
    tails = {name: Tail(path, last_lines=0) for name, path in paths.items()}
    for tail in tails.values():
        tail.read()

    def show(report: "RunReport") -> None:
        for name, tail in tails.items():
            for line in tail.read(unfinished=is_over(report)).splitlines():
                terminal.say(f"{name}: {line}" if len(tails) > 1 else line)

    return nullcontext(show)


def nothing() -> Display:
    return nullcontext(lambda report: None)


def is_over(report: "RunReport") -> bool:
    return report.state not in ("starting", "running")


def _reports(config: "RunConfig", stop: threading.Event | None = None) -> "Iterator[RunReport]":
    reader = history.HistoryReader()
    clock = stop or threading.Event()
    last: RunReport | None = None
    while True:
        stopped = clock.is_set()
        report = status.inspect(config, reader, anywhere=True)
        if last is not None and not report.history:  # the bucket did not answer this time
            report = replace(
                report,
                history=last.history,
                best=last.best,
                last=last.last,
                best_laps=last.best_laps,
                newest_laps=last.newest_laps,
            )
        yield report
        if stopped or (stop is None and is_over(report)):
            return
        last = report
        clock.wait(POLL_S)


def end(report: "RunReport", prefix: str) -> int:
    """Tell how a training ended; `prefix`: the model of the settings, for what to do next."""
    terminal.emit(report, None)
    if report.state in ("stopped", "interrupted") or report.exit_code == 0:
        terminal.say(report.end_text())
        commands = training_display.next_commands(report)
        terminal.suggest(commands, model=report.prefix, usual=prefix)
    else:
        terminal.fail(report.message, report.remedy)
    return WorkerDied.code if report.exit_code is None else report.exit_code
