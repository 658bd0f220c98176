"""What pages of the console cost: processor time of its process, while a training runs or after it.

    python scripts/bench console_cost FOLDER [--viewers 5] [--seconds 60] [--json]

FOLDER is a working folder whose console runs (`dr console start`). In turns, nobody watches, and so
many pages watch all that the live page shows of run 0, without a browser. The share of the machine
that the console uses is the most that it can cost a training in steps/s; what its workers spend is
in the other numbers. With --json the last line of stdout is one object with

    idle_core_share      processor time of the console in a second while nobody watches
    watched_core_share   the same while all watch
    watched_cost         the difference as a share of all cores: the most that a training loses
    bytes_per_s          what one page gets in a second
    rate_per_s           by view of sim-0: what one page gets in a second, in the middle and at most
                         in any second
    age_ms               by view of sim-0: median and 95th percentile of the time from the end of a
                         step until the page has it
    memory_mb            of the console before and after: resident
"""

import argparse
import json
import os
import sys
import threading
import time
from collections import Counter
from contextlib import ExitStack, suppress
from pathlib import Path
from statistics import median
from typing import Any

import psutil
from machine import print_json
from websockets.sync.client import ClientConnection, connect

from drcli.web.security import cookie_name
from drcli.web.viewer_process import running_viewer

VIEWS = ("camera", "chase", "scene")
TOPICS = ["run", "iterations", "machine", "tasks", "workers"]
TOPICS += [f"live:0:sim-0:{view}" for view in (*VIEWS, "state")]


def measure(folder: Path, viewers: int, seconds: float) -> dict[str, Any]:
    """Watch in turns with nobody, and compare."""
    record = running_viewer(folder)
    if record is None:
        sys.exit(f"No console of {folder} runs; start it with dr console start.")
    process = psutil.Process(record.pid)
    url, token = f"{record.host}:{record.port}", record.token
    found: dict[bool, list[float]] = {False: [], True: []}
    received = 0
    seen: dict[str, list[tuple[float, float]]] = {view: [] for view in VIEWS}
    memory = [process.memory_info().rss]
    block_s = seconds / 6
    for block in range(6):
        watched = block % 2 == 1
        with ExitStack() as pages:
            opened = [
                pages.enter_context(
                    connect(
                        f"ws://{url}/ws",
                        origin=f"http://{url}",  # type: ignore[arg-type]
                        additional_headers={"Cookie": f"{cookie_name(token)}={token}"},
                    )
                )
                for _ in range(viewers if watched else 0)
            ]
            for page in opened:
                page.send(json.dumps({"watch": TOPICS}))
            used, began_s = _used_s(process), time.monotonic()
            received += _read(opened, block_s, seen)
            found[watched].append((_used_s(process) - used) / (time.monotonic() - began_s))
    memory.append(process.memory_info().rss)
    idle, busy = (sum(found[each]) / len(found[each]) for each in (False, True))
    return {
        "idle_core_share": round(idle, 5),
        "watched_core_share": round(busy, 5),
        "watched_cost": round((busy - idle) / (os.cpu_count() or 1), 5),
        "bytes_per_s": round(received / viewers / (3 * block_s)),
        "rate_per_s": {view: _rates(seen[view]) for view in VIEWS if seen[view]},
        "age_ms": {view: _ages_ms(seen[view]) for view in VIEWS if seen[view]},
        "memory_mb": [round(each / 1e6, 1) for each in memory],
    }


def _used_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _read(
    pages: list[ClientConnection], seconds: float, seen: dict[str, list[tuple[float, float]]]
) -> int:
    """Read what all pages get; its size. Of the first page, note when views came and how old."""
    if not pages:
        time.sleep(seconds)
        return 0
    end_s = time.monotonic() + seconds
    sizes = [0] * len(pages)

    def read(number: int) -> None:
        while (left_s := end_s - time.monotonic()) > 0:
            with suppress(TimeoutError):
                message = pages[number].recv(timeout=left_s)
                sizes[number] += len(message)
                if number == 0:
                    _note(message, seen)

    threads = [threading.Thread(target=read, args=(number,)) for number in range(len(pages))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sum(sizes)


def _note(message: str | bytes, seen: dict[str, list[tuple[float, float]]]) -> None:
    now_s = time.time()
    if isinstance(message, bytes):
        header = json.loads(message[2 : 2 + int.from_bytes(message[:2], "big")])
        topic, step_s = header["topic"], header["step_s"]
    elif message.startswith('{"topic":"live:') and ":scene" in message[:40]:
        told = json.loads(message)
        topic, step_s = told["topic"], told["data"]["step_s"]
    else:
        return
    seen[topic.rsplit(":", 1)[1]].append((now_s, now_s - step_s))


def _rates(seen: list[tuple[float, float]]) -> list[int]:
    """Messages in a second: the median of the seconds with any, and the most."""
    counts = Counter(int(now_s) for now_s, _ in seen)
    return [round(median(counts.values())), max(counts.values())]


def _ages_ms(seen: list[tuple[float, float]]) -> list[float]:
    ages = sorted(1e3 * age_s for _, age_s in seen)
    return [round(median(ages), 1), round(ages[int(0.95 * len(ages))], 1)]


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
        print_json(found)


if __name__ == "__main__":
    main()
