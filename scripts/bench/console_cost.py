"""What pages of the console cost: processor time of its process, while a training runs or after it.

    python scripts/bench console_cost FOLDER [--viewers 5] [--seconds 60] [--json]

FOLDER is a working folder whose console runs (`dr-start-viewer`). In turns, nobody watches, and so
many pages watch the run, its iterations and the machine, without a browser. The share of the
machine that the console uses is the most that it can cost a training in steps/s. With --json the
last line of stdout is one object with

    idle_core_share      processor time of the console in a second while nobody watches
    watched_core_share   the same while all watch
    watched_cost         the difference as a share of all cores: the most that a training loses
    bytes_per_s          what one page gets in a second
    memory_mb            of the console before and after: resident
"""

import argparse
import json
import os
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil
from websockets.sync.client import ClientConnection, connect

from drcli.web.viewer_process import running_viewer

TOPICS = ["run", "iterations", "machine", "tasks"]


def measure(folder: Path, viewers: int, seconds: float) -> dict[str, Any]:
    """Watch in turns with nobody, and compare."""
    record = running_viewer(folder)
    if record is None:
        sys.exit(f"No console of {folder} runs; start it with dr-start-viewer.")
    process = psutil.Process(record.pid)
    url = f"{record.host}:{record.port}"
    found: dict[bool, list[float]] = {False: [], True: []}
    received = 0
    memory = [process.memory_info().rss]
    block_s = seconds / 6
    for block in range(6):
        watched = block % 2 == 1
        with ExitStack() as pages:
            opened = [
                pages.enter_context(connect(f"ws://{url}/ws", origin=f"http://{url}"))  # type: ignore[arg-type]
                for _ in range(viewers if watched else 0)
            ]
            for page in opened:
                page.send(json.dumps({"watch": TOPICS}))
            used, began_s = _used_s(process), time.monotonic()
            received += _read(opened, block_s)
            found[watched].append((_used_s(process) - used) / (time.monotonic() - began_s))
    memory.append(process.memory_info().rss)
    idle, busy = (sum(found[each]) / len(found[each]) for each in (False, True))
    return {
        "idle_core_share": round(idle, 5),
        "watched_core_share": round(busy, 5),
        "watched_cost": round((busy - idle) / (os.cpu_count() or 1), 5),
        "bytes_per_s": round(received / viewers / (3 * block_s)),
        "memory_mb": [round(each / 1e6, 1) for each in memory],
    }


def _used_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _read(pages: list[ClientConnection], seconds: float) -> int:
    """Read what all pages get; its size."""
    size, end_s = 0, time.monotonic() + seconds
    while (left_s := end_s - time.monotonic()) > 0:
        if not pages:
            time.sleep(left_s)
            continue
        for page in pages:
            try:
                size += len(page.recv(timeout=min(0.2, max(end_s - time.monotonic(), 0.001))))
            except TimeoutError:
                continue
    return size


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--viewers", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options.folder.resolve(), options.viewers, options.seconds)
    for name, value in found.items():
        print(f"{name:20} {value}")
    if options.json:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
