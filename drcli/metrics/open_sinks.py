"""Opens the sinks that settings ask for, and feeds them in the background.

A failing sink never stops a training.
"""

import importlib.util
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from drcli.base.errors import NotAvailable
from drcli.base.installation import lazy_imports
from drcli.base.log import get_logger
from drcli.config.run_config import FigureConfig
from drcli.metrics.event_file import EventFile
from drcli.metrics.figure_events import Event, Point, Sink, TrainingFacts
from drcli.metrics.prometheus_text import FigureFile, FigureServer, InfluxLines

with lazy_imports():
    from drcli.metrics import servers


_logger = get_logger(__name__)

MOST_WAITING = 10_000
"""Beyond this, the newest events are dropped, which bounds memory."""

PAUSE_S = 60.0
"""An absent host costs milliseconds a minute, not a timeout for each event."""

CLOSING_S = 5.0
"""What a worker's end waits at most."""


MOST_CAUSES = 5
"""Logged per failure, as some texts differ each time."""


@dataclass
class _Watched:
    """A sink, opened when possible and left alone after failures."""

    opener: Callable[[], Sink]
    sink: Sink | None = None
    resumes_s: float = 0.0
    causes: list[str] = field(default_factory=list)
    missed: Counter[type[Event]] = field(default_factory=Counter)
    lost: int = 0
    given_up: bool = False

    def miss(self, event: Event) -> None:
        if self.sink is None:
            self.missed[type(event)] += 1
        elif isinstance(event, self.sink.takes):
            self.lost += not self.sink.miss(event)


class FigureSender:
    """A queue and a thread that feeds sinks, if there are any.

    `open_sinks` runs in the thread, as libraries load slowly; failures are retried.
    """

    def __init__(
        self,
        open_sinks: Sequence[Callable[[], Sink]],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._openers = list(open_sinks)
        self._clock = clock
        self._events: queue.Queue[Event | None] = queue.Queue(MOST_WAITING)
        self._is_full = False
        self._thread: threading.Thread | None = None
        if self._openers:
            self._thread = threading.Thread(target=self._run, name="figures", daemon=True)
            self._thread.start()

    def send(self, *events: Event) -> None:
        if self._thread is None:
            return
        for event in events:
            try:
                self._events.put_nowait(event)
            except queue.Full:
                if not self._is_full:
                    _logger.warning(
                        "Live figures: %d of them wait to be sent; newer ones are left out.",
                        MOST_WAITING,
                    )
                self._is_full = True

    def close(self, patience_s: float = CLOSING_S) -> None:
        """Send what is possible within the time."""
        if self._thread is None:
            return
        try:
            self._events.put(None, timeout=patience_s)
        except queue.Full:
            return  # the thread is stuck; it ends with the process
        self._thread.join(patience_s)
        if self._thread.is_alive():
            _logger.warning("Live figures: not all of them could be sent before the end.")
        self._thread = None

    def _run(self) -> None:
        watched = [_Watched(opener) for opener in self._openers]
        for item in watched:
            self._open(item)
        while (event := self._events.get()) is not None:
            for item in watched:
                self._give(item, event)
        for item in watched:
            self._close(item)
        own_s, all_s = time.thread_time(), time.process_time()
        _logger.info(
            "Live figures took %.2f s of processor time, %.2f %% of this process's.",
            own_s,
            100.0 * own_s / max(all_s, 1e-9),
        )

    def _open(self, item: _Watched) -> None:
        try:
            item.sink = item.opener()
        except ImportError as error:  # the package does not appear while the training runs
            item.given_up = True
            _logger.warning("Live figures: %s The training goes on without it.", _words(error))
        except Exception as error:  # a library of somebody else may raise anything
            self._failed(item, error)
        else:
            item.lost = sum(
                n for kind, n in item.missed.items() if issubclass(kind, item.sink.takes)
            )

    def _give(self, item: _Watched, event: Event) -> None:
        if item.given_up or (item.sink is not None and not isinstance(event, item.sink.takes)):
            return
        if self._clock() < item.resumes_s:
            item.miss(event)
            return
        if item.sink is None:
            self._open(item)
        if item.sink is None or not isinstance(event, item.sink.takes):
            item.miss(event)
            return
        try:
            item.sink.send(event)
        except Exception as error:
            self._failed(item, error)
            item.miss(event)
        else:
            if item.causes:
                _logger.info(
                    "Live figures: %s takes them again; %d were lost.", item.sink.name, item.lost
                )
            item.causes, item.lost = [], 0

    def _close(self, item: _Watched) -> None:
        if item.sink is None:
            return
        try:
            item.sink.close()
        except Exception as error:
            self._failed(item, error)
            _logger.info("Live figures: %s lacks the newest of them at the end.", item.sink.name)
            return
        if item.causes:
            _logger.info(
                "Live figures: %s has been closed; %d were lost.", item.sink.name, item.lost
            )

    def _failed(self, item: _Watched, error: Exception) -> None:
        item.resumes_s = self._clock() + PAUSE_S
        text = _words(error)
        name = f"{item.sink.name}: " if item.sink is not None else ""
        if not item.causes:
            _logger.warning(
                "Live figures: %s%s The training goes on; it is tried again.", name, text
            )
        elif text in item.causes or len(item.causes) >= MOST_CAUSES:
            return
        else:
            _logger.info("Live figures: %s%s", name, text)
        item.causes.append(text)


def _words(error: Exception) -> str:
    whole = str(error)
    if isinstance(error, OSError) and error.strerror:  # without its number
        whole = f"{error.strerror} ({error.filename})" if error.filename else error.strerror
    text = whole.strip().splitlines()
    words = text[0][:300] if text else type(error).__name__
    return words if words.endswith(".") else f"{words}."


# The sinks of a process.


def check_figures(config: FigureConfig) -> None:
    """Before a start; raises NotAvailable for a missing library."""
    if config.tensorboard and importlib.util.find_spec("tensorboard") is None:
        raise NotAvailable(
            "DR_TENSORBOARD=True needs the package tensorboard, which is not installed.",
            remedy='Install it with `pip install "drcli[tensorboard]"`, or set '
            "DR_TENSORBOARD=False.",
        )


def sender_of_trainer(
    config: FigureConfig,
    directory: Path,
    facts: TrainingFacts,
    *,
    earlier: Sequence[Point] = (),
    parameters: Mapping[str, str] | None = None,
) -> FigureSender:
    """`earlier` are points of iterations before, for sinks that lack them."""
    given, host, port = parameters or {}, config.prometheus_host, config.prometheus_port
    # Each loads its libraries when it is needed, and in the thread that sends.
    sinks: list[tuple[object, Callable[[], Sink]]] = [
        (
            config.tensorboard,
            lambda: EventFile(tensorboard_folder(directory, facts.model), facts, earlier),
        ),
        (
            config.prometheus_folder,
            lambda: FigureFile(directory / config.prometheus_folder, facts),
        ),
        (port, lambda: FigureServer(host, port, facts)),
        (
            config.mlflow_url,
            lambda: servers.MlflowRun(
                config.mlflow_url, config.mlflow_experiment, facts, given, earlier
            ),
        ),
        (
            config.trackio_url,
            lambda: servers.TrackioRun(config.trackio_url, config.trackio_project, facts, given),
        ),
    ]
    openers = [opener for wanted, opener in sinks if wanted]
    return FigureSender([*openers, *_telegraf(config, facts.model)])


def sender_of_episodes(config: FigureConfig, model: str) -> FigureSender:
    """For a simulation worker or an evaluation."""
    return FigureSender(_telegraf(config, model))


def event_folder(directory: Path) -> Path:
    return directory / "data" / "tensorboard"


def tensorboard_folder(directory: Path, model: str) -> Path:
    return event_folder(directory) / model


def _telegraf(config: FigureConfig, model: str) -> list[Callable[[], Sink]]:
    if not config.telegraf_host:
        return []
    return [partial(InfluxLines, config.telegraf_host, config.telegraf_port, model)]
