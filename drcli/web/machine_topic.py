"""Topic `machine`: processor, memory, disk and GPUs."""

import csv
import io
import os
import platform
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import psutil
from starlette.routing import BaseRoute

from drcli.base.memory_state import read_memory
from drcli.web.hub import Polled, Publish
from drcli.web.served_folder import ServedFolder
from drcli.web.topics import Snapshot

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


def _number(text: str, factor: float = 1.0) -> float | None:
    try:
        return float(text) * factor
    except ValueError:
        return None


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    processor = ProcessorMeter()

    def open_machine(topic: str, publish: Publish) -> Polled:
        def read() -> Snapshot:
            return Snapshot.of(topic, look(folder.directory, processor))

        return Polled(topic, publish, read, MACHINE_S)

    folder.hub.add_kind("machine", open_machine)
    return []
