"""Topics `run:N` (state) and `iterations:N` (learning curve); N is DR_RUN_ID."""

import csv
import io
import math
import os
import platform
import shutil
import subprocess
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import psutil
from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.base.json_record import plain
from drcli.base.memory import read_memory
from drcli.base.report import counted, size_text
from drcli.model.history import HistoryReader
from drcli.model.reconstruct import readable_history
from drcli.records.iteration import IterationRecord
from drcli.records.run_record import RunRecord, log_file, run_folder
from drcli.run.seen_in_bucket import seen_run
from drcli.run.status import RunReport, inspect
from drcli.web.answers import answers
from drcli.web.hub import Read
from drcli.web.live_words import Card, cards_here, number, run_words
from drcli.web.served_folder import ServedFolder
from drcli.web.topics import Marker, Message, Rows, text_message

RUN_S = 1.0
NEW_S = 0.8
_OF_RUN = r"(?::(\d{0,2}))?"
"""Without a number, that of run.env."""


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


def shown_run(
    report: RunReport, history: Sequence[IterationRecord], own_run: int, cards: Sequence[Card] = ()
) -> dict[str, Any]:
    """A run as the page shows it; what changes each second unseen would cost a redrawing."""
    kept = ("run_id", "prefix", "world", "state", "message", "remedy")
    facts = {name: getattr(report, name) for name in (*kept, "unreachable", "limit", "best")}
    return facts | {"words": run_words(report, history, own_run), "cards": cards}


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """`GET /api/folder`."""
    readers: dict[int | None, RunReader] = {}

    def reader_of(run: str | None) -> RunReader:
        run_id = int(run) if run else None
        return readers.setdefault(run_id, RunReader(folder, run_id))

    def run(_: str, run_id: str | None) -> Read:
        reader = reader_of(run_id)

        def read() -> dict[str, Any]:
            report = reader.report()
            history = report.history if report.unreachable else reader.history()
            cards = cards_here(report, folder.live.workers(), folder.live.car)
            return shown_run(report, history, folder.settings().run_id, cards)

        return read

    def iterations(topic: str, run_id: str | None) -> Read:
        reader, rows = reader_of(run_id), Rows(topic)

        def read() -> Rows:
            if not reader.report().unreachable:  # else the page keeps its curves
                rows.update(reader.history())
            return rows

        return read

    folder.hub.poll(f"run{_OF_RUN}", RUN_S, run)
    folder.hub.poll(f"iterations{_OF_RUN}", RUN_S, iterations)

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


# Topics `log:RUN:NAME`: the newest lines of a log of a run.
#
# NAME is `supervisor`, `trainer`, `sim-0`, `reward-0` (prints of the reward function in sim-0) or
# `evaluation`.


LOG_S = 0.7
KEPT_LINES = 300

MOST_BYTES = 1 << 16
LONGEST_LINE = 1_000
_TOPIC = r"log:(\d{1,2}):(supervisor|trainer|evaluation|(?:sim|reward)-\d{1,3})"


@dataclass(frozen=True, eq=False)
class LogLines:
    """The newest lines of a log.

    Attributes:
        file: Another number when the log began anew.
        total: Lines that were read of it.
        note: Why there is no log.
    """

    topic: str
    file: int
    total: int
    lines: tuple[str, ...]
    note: str = ""

    def message(self, since: Marker | None) -> tuple[Message | None, Marker]:
        """`{"anew", "lines", "note"}`: lines to add, or to show instead."""
        marker = (self.file, self.total, self.note)
        if since == marker:
            return None, marker
        known = since[1] if since is not None and since[0] == self.file else None
        anew = known is None
        new = len(self.lines) if known is None else min(self.total - known, len(self.lines))
        lines = list(self.lines[len(self.lines) - new :])
        data = {"anew": anew, "lines": lines, "note": self.note}
        return text_message(self.topic, data), marker


class LogReader:
    """Of new lines."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._path: Path | None = None
        self._inode, self._offset = 0, 0
        self._file, self._total = 0, 0
        self._rest = b""
        self._lines: deque[str] = deque(maxlen=KEPT_LINES)

    def read(self, path: Path | None, missing: str) -> LogLines:
        note = ""
        try:
            if path is None:
                raise FileNotFoundError
            self._add(path)
        except FileNotFoundError:
            note = missing
            if self._total:
                self._begin(None, 0)
        except OSError as error:
            note = f"{path} cannot be read: {error.strerror}."
        return LogLines(self._topic, self._file, self._total, tuple(self._lines), note)

    def _begin(self, path: Path | None, inode: int) -> None:
        self._path, self._inode, self._offset = path, inode, 0
        self._file += 1
        self._total, self._rest = 0, b""
        self._lines.clear()

    def _add(self, path: Path) -> None:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            if (path, status.st_ino) != (self._path, self._inode) or status.st_size < self._offset:
                self._begin(path, status.st_ino)
            begin = max(self._offset, status.st_size - MOST_BYTES)
            file.seek(begin)
            data = file.read(MOST_BYTES)
            end = file.tell()
        if begin > self._offset:
            # The first line would be a part of one, and so perhaps a part of a secret.
            self._rest, data = b"", data.partition(b"\n")[2]
        self._offset = end
        *whole, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[:MOST_BYTES]
        for line in whole:
            text = line.decode("utf-8", "replace").rstrip("\r")
            self._lines.append(text[:LONGEST_LINE])
        self._total += len(whole)


def log_routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    def log(topic: str, run_id: str, name: str) -> Read:
        reader = LogReader(topic)

        def read() -> LogLines:
            record = RunRecord.read(run_folder(folder.directory, int(run_id)))
            prefix = record.prefix if record is not None else folder.settings().model_prefix
            path = log_file(folder.directory, prefix, name)
            return reader.read(path, _missing(name))

        return read

    folder.hub.poll(_TOPIC, LOG_S, log)
    return []


def _missing(name: str) -> str:
    if name.startswith("reward-"):
        return "The reward function has printed nothing yet. Use print() in it to see values here."
    return f"There is no log of {name} on this machine yet. It begins when {name} starts."


# Topic `machine`: processor, memory, disk and GPUs.


MACHINE_S = 2.0
NVIDIA_S = 5.0


@dataclass(frozen=True)
class Gpu:
    """NVIDIA."""

    name: str
    percent: float | None
    memory_bytes: float | None
    memory_used_bytes: float | None


@dataclass(frozen=True)
class Machine:
    """What a machine has and uses.

    Attributes:
        processor_percent: Of all cores, since the last look.
        load: Mean number of processes that run or wait, over a minute.
        memory_bytes: RAM, or the limit of the container.
        disk_bytes: Of the working folder's disk.
    """

    name: str
    cores: int
    processor_percent: float
    load: float | None
    memory_bytes: int
    memory_used_bytes: int
    disk_bytes: int
    disk_used_bytes: int
    gpus: list[Gpu] = field(default_factory=list)


class ProcessorMeter:
    """How busy all cores were since the last look, whichever thread looks.

    psutil.cpu_percent looks per thread: in a pool it gives 0, or the mean of a long time.
    """

    def __init__(self) -> None:
        self._total_s, self._idle_s = _processor_times()

    def percent(self) -> float:
        total_s, idle_s = _processor_times()
        passed_s, unused_s = total_s - self._total_s, idle_s - self._idle_s
        self._total_s, self._idle_s = total_s, idle_s
        return min(100.0, max(0.0, 100.0 * (1.0 - unused_s / passed_s))) if passed_s > 0 else 0.0


def _processor_times() -> tuple[float, float]:
    """Seconds of all cores since the start, and idle ones."""
    times = psutil.cpu_times()
    # Linux counts guests in user and nice already.
    counted = {name: s for name, s in times._asdict().items() if not name.startswith("guest")}
    return sum(counted.values()), times.idle + counted.get("iowait", 0.0)


def look(directory: Path, processor: ProcessorMeter) -> Machine:
    memory, disk = read_memory(), psutil.disk_usage(str(directory))
    return Machine(
        name=_processor(),
        cores=os.cpu_count() or 1,
        processor_percent=processor.percent(),
        load=os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        memory_bytes=memory.total_bytes,
        memory_used_bytes=memory.total_bytes - memory.available_bytes,
        disk_bytes=disk.total,
        disk_used_bytes=disk.total - disk.free,
        gpus=_gpus(),
    )


@cache
def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor()


def _gpus() -> list[Gpu]:
    program = shutil.which("nvidia-smi")
    if program is None:
        return []
    question = "--query-gpu=name,utilization.gpu,memory.total,memory.used"
    try:
        said = subprocess.run(
            [program, question, "--format=csv,noheader,nounits"],
            capture_output=True,
            text=True,
            timeout=NVIDIA_S,
            check=True,
        ).stdout
    except (OSError, subprocess.SubprocessError):
        return []
    rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(said))]
    return [
        Gpu(row[0], _number(row[1]), _number(row[2], 1 << 20), _number(row[3], 1 << 20))
        for row in rows
        if len(row) == 4
    ]


def machine_words(machine: Machine) -> dict[str, Any]:
    """Its name, and meters of name, text and share that is used."""
    memory = machine.memory_used_bytes, machine.memory_bytes
    disk = machine.disk_used_bytes, machine.disk_bytes
    percent = machine.processor_percent
    load = "" if machine.load is None else f", load {machine.load:.1f}"
    gpus = [
        (
            gpu.name or f"GPU {k}",
            f"{number(gpu.percent, 0, '%')}, {_used(gpu.memory_used_bytes, gpu.memory_bytes)}",
            (gpu.percent or 0.0) / 100.0,
        )
        for k, gpu in enumerate(machine.gpus)
    ]
    return {
        "text": f"{machine.name or 'Processor'}, {counted(machine.cores, 'core')}{load}",
        "meters": [
            ("Processor", number(percent, 0, "%"), percent / 100.0),
            ("Memory", _used(*memory), memory[0] / memory[1]),
            ("Disk of the folder", _used(*disk), disk[0] / disk[1]),
            *gpus,
        ],
    }


def _used(part: float | None, whole: float | None) -> str:
    return " of ".join("–" if size is None else size_text(int(size)) for size in (part, whole))


def _number(text: str, factor: float = 1.0) -> float | None:
    try:
        return float(text) * factor
    except ValueError:
        return None


def machine_routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    processor = ProcessorMeter()

    def read() -> dict[str, Any]:
        machine = look(folder.directory, processor)
        return {**plain(machine), **machine_words(machine)}

    folder.hub.poll("machine", MACHINE_S, lambda _: read)
    return []
