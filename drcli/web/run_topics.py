"""Topics `run:N` (state) and `iterations:N` (learning curve); N is DR_RUN_ID."""

import math
import threading
import time
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.exchange.iteration import IterationRecord
from drcli.exchange.run_record import run_folder
from drcli.runs.seen_in_bucket import seen_run
from drcli.runs.status import RunReport, inspect
from drcli.store.history import HistoryReader
from drcli.store.repair import readable_history
from drcli.web.answers import answers
from drcli.web.hub import Polled, Publish
from drcli.web.served_folder import ServedFolder
from drcli.web.topics import Rows, Snapshot, Value

RUN_S = 1.0
NEW_S = 0.8


class RunReader:
    """Reads a run once for all topics."""

    def __init__(self, folder: ServedFolder, run_id: int | None) -> None:
        self._folder, self._run_id = folder, run_id
        self._reader = HistoryReader()
        self._lock = threading.Lock()
        self._report: RunReport | None = None
        self._read_s = -math.inf

    def report(self) -> RunReport:
        with self._lock:
            if self._report is None or time.monotonic() - self._read_s > NEW_S:
                settings = self._folder.settings()
                if self._run_id is not None:
                    settings = settings.replaced(run_id=self._run_id)
                self._report = inspect(settings.run, self._reader)
                self._read_s = time.monotonic()
            return self._report

    def history(self) -> list[IterationRecord]:
        """Also of a model that only another machine trains."""
        report = self.report()
        if report.state != "none" or self._run_id is None:
            return report.history
        with self._lock:
            model = seen_run(self._folder.settings(), self._run_id).model
            return [] if model is None else readable_history(model, self._reader)[0]


def without_history(report: RunReport) -> dict[str, Any]:
    """Iterations have their own topic."""
    kept = [field.name for field in fields(report) if field.name != "history"]
    return {name: getattr(report, name) for name in kept} | {"dead": report.dead}


def _run_id(topic: str) -> int | None:
    """None for that of run.env."""
    text = topic.partition(":")[2]
    number = int(text) if text else None
    if number is not None and not 0 <= number <= 99:
        raise ValueError(topic)
    return number


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """`GET /api/folder`."""
    readers: dict[int | None, RunReader] = {}

    def reader_of(topic: str) -> RunReader:
        run_id = _run_id(topic)
        return readers.setdefault(run_id, RunReader(folder, run_id))

    def open_run(topic: str, publish: Publish) -> Polled:
        reader = reader_of(topic)
        return Polled(
            topic, publish, lambda: Snapshot.of(topic, without_history(reader.report())), RUN_S
        )

    def open_iterations(topic: str, publish: Publish) -> Polled:
        reader = reader_of(topic)
        rows = Rows(topic)

        def read() -> Value:
            if not reader.report().unreachable:  # else the page keeps its curves
                rows.update(reader.history())
            return rows

        return Polled(topic, publish, read, RUN_S)

    folder.hub.add_kind("run", open_run)
    folder.hub.add_kind("iterations", open_iterations)

    def about(_: Request) -> Any:
        settings = folder.settings()
        return {
            "folder": str(folder.directory),
            "bucket": settings.bucket,
            "model": settings.model_prefix,
            "run_id": settings.run_id,
            "world": settings.world_name,
            "cloud": settings.storage.cloud,
            "run_exists": run_folder(folder.directory, settings.run_id).is_dir(),
        }

    return [Route("/api/folder", answers(about))]
