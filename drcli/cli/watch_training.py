"""Shows a running training: live, as lines, or by its logs."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from drcli.cli import console
from drcli.cli.log_tail import Tail
from drcli.cli.views import iterations, training_view

if TYPE_CHECKING:
    from drcli.config.run_config import RunConfig
    from drcli.exchange.iteration import IterationRecord
    from drcli.runs.status import RunReport

POLL_S = 1.0
NEXT = [
    ("dr-logs trainer -f", "follow the trainer's log"),
    ("dr-status", "show the progress"),
    ("dr-stop-training", "stop; what was learned is kept"),
]

Show = Callable[["RunReport"], None]
Display = AbstractContextManager[Show]


def until_the_end(config: "RunConfig", display: Display) -> "RunReport | None":
    """Watch a training; None after Ctrl-C or a closed pipe."""
    try:
        with display as show:
            for report in _reports(config):
                show(report)
                if console.reader_has_left():
                    return None
        return report
    except KeyboardInterrupt:
        return None


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
    from rich.live import Live

    with Live(console=console.err, auto_refresh=False) as screen:
        yield lambda report: screen.update(
            training_view.live(report, time.time(), verbose=verbose), refresh=True
        )


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
                console.say(iterations.line(record, verbose=verbose))
        if report.warning and not warned:
            console.warn(f"{report.warning}.")
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
                console.say(f"{name}: {line}" if len(tails) > 1 else line)

    return nullcontext(show)


def nothing() -> Display:
    return nullcontext(lambda report: None)


def is_over(report: "RunReport") -> bool:
    return report.state not in ("starting", "running")


def _reports(config: "RunConfig", stop: threading.Event | None = None) -> "Iterator[RunReport]":
    from drcli.runs.status import inspect
    from drcli.store.history import HistoryReader

    reader = HistoryReader()
    clock = stop or threading.Event()
    last: RunReport | None = None
    while True:
        stopped = clock.is_set()
        report = inspect(config, reader)
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
