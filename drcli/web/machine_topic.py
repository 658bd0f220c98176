"""Topic `machine`: processor, memory, disk and graphics processor of this machine."""

import csv
import io
import itertools
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
"""How long nvidia-smi may take."""


@dataclass(frozen=True)
class Gpu:
    """One NVIDIA GPU: how busy it is in percent, its memory in bytes; null where unknown."""

    name: str
    percent: float | None
    memory_bytes: float | None
    memory_used_bytes: float | None


@dataclass(frozen=True)
class Machine:
    """What a machine has, and what of it is used.

    Attributes:
        name: Of the processor; empty if unknown.
        cores: Logical processors.
        processor_percent: Of all cores, since the last look; null at the first one.
        load: Mean number of processes that run or wait, over a minute; null where unknown.
        memory_bytes: RAM, or the limit of the container.
        memory_used_bytes: What of it is in use.
        disk_bytes: Of the disk of the working folder.
        disk_used_bytes: What of it is in use.
        gpus: NVIDIA GPUs.
    """

    name: str
    cores: int
    processor_percent: float | None
    load: float | None
    memory_bytes: int
    memory_used_bytes: int
    disk_bytes: int
    disk_used_bytes: int
    gpus: list[Gpu] = field(default_factory=list)


def look(directory: Path, processor_percent: float | None = None) -> Machine:
    """The machine as it is now.

    Args:
        directory: The disk of this folder is shown.
        processor_percent: How busy the processor was; None if nobody has looked before.
    """
    memory, disk = read_memory(), psutil.disk_usage(str(directory))
    return Machine(
        name=_processor(),
        cores=os.cpu_count() or 1,
        processor_percent=processor_percent,
        load=os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        memory_bytes=memory.total_bytes,
        memory_used_bytes=memory.total_bytes - memory.available_bytes,
        disk_bytes=disk.total,
        disk_used_bytes=disk.total - disk.free,
        gpus=_gpus(),
    )


@cache
def _processor() -> str:
    """Name of the processor."""
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
    """A number of nvidia-smi; None for "[N/A]"."""
    try:
        return float(text) * factor
    except ValueError:
        return None


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    """Declare the topic; there is no route."""

    def open_machine(topic: str, publish: Publish) -> Polled:
        looks = itertools.count()

        def snapshot() -> Snapshot:
            percent = psutil.cpu_percent()  # since the last call, so the first says nothing
            known = percent if next(looks) else None
            return Snapshot.of(topic, look(folder.directory, known))

        return Polled(topic, publish, snapshot, MACHINE_S)

    folder.hub.add_kind("machine", open_machine)
    return []
