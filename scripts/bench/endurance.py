"""What grows in a long training: memory, open files, disk, time and requests of an iteration.

    python scripts/bench endurance [--iterations 10000] [--minutes 60] [--late 10000] [--json]

Trains with the real commands and the smallest iterations: one episode that ends at once, one epoch.
It counts the requests between the processes and the embedded server's program, and reads memory
(PSS: shared pages counted once), open files, threads and processor time of every process from
/proc. The table has a column for each quarter of the iterations; what grows between the second
quarter and the last is measured against the bars.

With --late, it also makes that model look as if it had so many iterations more (records, metrics
and traces), resumes it, and compares its iterations with those at the beginning: the growth of
10,000 iterations in minutes. On a busy machine, compare processor times. With --records 10000, it
only writes the records of so many iterations, with 20 episodes each, and trains nothing.
"""

import argparse
import json
import os
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import psutil
import record_growth
from counting_proxy import CountingProxy
from late_model import age
from machine import print_json

from drcli.bucket.server.server_process import launch_of

PROJECT = Path(__file__).resolve().parents[2]
PREFIX = "endurance"
KEYS = ("endurance-access", "endurance-secret")
SAMPLE_S = 2.0
BAR = 0.05
"""Largest growth of memory and of the time of an iteration."""

RUN_ENV = f"""DR_WORLD_NAME=reinvent_base
DR_LOCAL_S3_MODEL_PREFIX={PREFIX}
DR_TRAIN_MIN_EVAL_TRIALS=1
DR_TRAIN_EVAL_SHARE=0.02
DR_TRAIN_OVERLAP=off
DR_TRAIN_SEED=1
DR_TRAIN_FROZEN_GRAPH=False
"""

PARAMETERS = {
    "batch_size": 64,
    "num_epochs": 1,
    "num_episodes_between_training": 1,
    "lr": 1e-8,  # a policy that improved would drive longer episodes
}


@dataclass
class Sample:
    """One look at a running training.

    Attributes:
        iteration: Newest checkpoint.
        time_s: Wall clock.
        requests: Of all processes so far, without those that are repeated while a process waits.
        waiting: Those.
        sent_bytes: Written to the bucket so far.
        pss_mb: Memory by process.
        files: Open files by process.
        threads: By process.
        cpu_s: Processor time by process.
        disk_mb: By kind.
    """

    iteration: int
    time_s: float
    requests: int
    waiting: int
    sent_bytes: int
    pss_mb: dict[str, float] = field(default_factory=dict)
    files: dict[str, int] = field(default_factory=dict)
    threads: dict[str, int] = field(default_factory=dict)
    cpu_s: dict[str, float] = field(default_factory=dict)
    disk_mb: dict[str, float] = field(default_factory=dict)


class Workspace:
    """A working folder with its own server behind a counting proxy."""

    def __init__(self, folder: Path, traces_mb: int) -> None:
        self.folder = folder
        self.data = folder / "objects"
        (self.data / "bucket").mkdir(parents=True)
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        launch = launch_of("rclone", self.data, port, access_key=KEYS[0], secret_key=KEYS[1])
        self.server = subprocess.Popen(
            launch.command, env={**os.environ, **launch.variables}, stderr=subprocess.DEVNULL
        )
        self.proxy = CountingProxy(port)
        names = dict(zip(("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"), KEYS, strict=True))
        self.environment = {k: v for k, v in os.environ.items() if not k.startswith("DR_")} | names
        custom = folder / "custom_files"
        shutil.copytree(PROJECT / "defaults", custom)
        parameters = json.loads((custom / "hyperparameters.json").read_text())
        (custom / "hyperparameters.json").write_text(json.dumps(parameters | PARAMETERS))
        (custom / "reward_function.py").write_text("def reward_function(params):\n    return 1.0\n")
        metadata = json.loads((custom / "model_metadata.json").read_text())
        metadata["action_space"] = [{"steering_angle": a, "speed": 4.0} for a in (-30, 30)]
        (custom / "model_metadata.json").write_text(json.dumps(metadata))
        (folder / "run.env").write_text(f"{RUN_ENV}DR_TRAIN_TRACES_MAX_MB={traces_mb}\n")
        (folder / "system.env").write_text(
            f"DR_CLOUD=remote\nDR_REMOTE_MINIO_URL={self.proxy.url}\nDR_LOCAL_S3_BUCKET=bucket\n"
            "DR_LOCAL_S3_PROFILE=\nDR_LOG_MAX_MB=64\n"
        )
        self._iteration = 0
        self.run_file = folder / "data" / "runs" / "0" / "run.json"

    @property
    def model(self) -> Path:
        """The model's folder."""
        return self.data / "bucket" / PREFIX

    def command(self, *arguments: str) -> None:
        """Run a command of drcli."""
        program = str(Path(sys.executable).parent / "dr")
        subprocess.run([program, *arguments], cwd=self.folder, env=self.environment, check=True)

    def record(self) -> dict[str, Any]:
        """The record of the run."""
        return json.loads(self.run_file.read_text())

    def iteration(self) -> int:
        """Number of the newest checkpoint."""
        with suppress(OSError, ValueError):  # it is just being written
            text = (self.model / "model" / ".coach_checkpoint").read_text()
            self._iteration = int(text.partition("_")[0])
        return self._iteration

    def sample(self, *, disk: bool) -> Sample:
        """Look at all processes now."""
        record = self.record()
        pids = {worker["name"]: worker["pid"] for worker in record["workers"]}
        pids |= {"supervisor": record["pid"], "server": self.server.pid}
        proxy = self.proxy
        taken = Sample(
            self.iteration(), time.time(), proxy.requests, proxy.waiting, proxy.sent_bytes
        )
        for name, pid in pids.items():
            try:
                process = psutil.Process(pid)
                taken.pss_mb[name] = process.memory_full_info().pss / 1e6
                taken.files[name] = process.num_fds()
                taken.threads[name] = process.num_threads()
                taken.cpu_s[name] = sum(process.cpu_times()[:2])
            except psutil.Error:
                continue
        if disk:
            taken.disk_mb = self.disk_mb()
        return taken

    def disk_mb(self) -> dict[str, float]:
        """Size of all files by kind."""
        sizes: dict[str, float] = defaultdict(float)
        for top, kind in ((self.data, ""), (self.folder / "data", "local logs and runs")):
            for place, _, names in os.walk(top):
                for path in (Path(place, name) for name in names):
                    with suppress(OSError):  # it was deleted meanwhile
                        sizes[kind or self._kind(path)] += path.stat().st_blocks * 512 / 1e6
        return dict(sizes)

    def _kind(self, path: Path) -> str:
        first, *rest = path.relative_to(self.data / "bucket").parts
        return rest[0] if first == PREFIX else first

    def close(self) -> None:
        """End the server."""
        self.server.terminate()
        self.server.wait()
        self.proxy.close()


@contextmanager
def workspace(traces_mb: int) -> Iterator[Workspace]:
    """A new workspace that is deleted afterwards."""
    with tempfile.TemporaryDirectory(prefix="bench-endurance-") as name:
        made = Workspace(Path(name), traces_mb)
        try:
            time.sleep(1.0)
            yield made
        finally:
            made.close()


def watch(work: Workspace, iterations: int, minutes: float, *options: str) -> list[Sample]:
    """Start a training, sample it until it has done so many iterations, and stop it."""
    work.command("start-training", "-q", *options)
    samples: list[Sample] = []
    began_s, first = time.time(), work.iteration()
    try:
        while time.time() < began_s + 60 * minutes:
            samples.append(work.sample(disk=len(samples) % 20 == 0))
            if samples[-1].iteration >= first + iterations:
                break
            if work.record()["state"] not in ("starting", "running"):
                sys.exit(f"The training ended: {work.record()['message']}")
            time.sleep(SAMPLE_S)
    finally:
        work.command("stop-training")
    return samples


def quarters(samples: list[Sample]) -> list[dict[str, Any]]:
    """The means of each quarter of the iterations."""
    first, last = samples[0].iteration, samples[-1].iteration
    found = []
    for quarter in range(4):
        low, high = (first + (last - first) * (quarter + k) / 4 for k in (0, 1))
        some = [s for s in samples if low <= s.iteration <= high]
        begin, end = some[0], some[-1]
        done = max(1, end.iteration - begin.iteration)
        disk = [s.disk_mb for s in some if s.disk_mb]
        found.append(
            {
                "iterations": [begin.iteration, end.iteration],
                "pss_mb": _means(s.pss_mb for s in some),
                "files": _means(s.files for s in some),
                "threads": _means(s.threads for s in some),
                "wall_ms": 1000 * (end.time_s - begin.time_s) / done,
                "cpu_ms": {
                    name: 1000 * (end.cpu_s[name] - begin.cpu_s[name]) / done
                    for name in end.cpu_s
                    if name in begin.cpu_s
                },
                "requests": (end.requests - begin.requests) / done,
                "waiting_per_s": (end.waiting - begin.waiting)
                / max(1.0, end.time_s - begin.time_s),
                "sent_kb": (end.sent_bytes - begin.sent_bytes) / done / 1e3,
                "disk_mb": disk[-1] if disk else {},
            }
        )
    return found


def _means(values: Any) -> dict[str, float]:
    known: dict[str, list[float]] = defaultdict(list)
    for each in values:
        for name, value in each.items():
            known[name].append(value)
    return {name: statistics.fmean(of_name) for name, of_name in sorted(known.items())}


def table(columns: list[dict[str, Any]], names: list[str]) -> str:
    """The measured numbers by quarter, and how much the last is above the second."""
    rows = [["", *names, "growth"]]

    def add(name: str, values: list[float], digits: int = 1) -> None:
        start, end = values[min(1, len(values) - 2)], values[-1]
        growth = f"{100 * (end / start - 1):+.1f} %" if start else "-"
        rows.append([name, *(f"{value:.{digits}f}" for value in values), growth])

    rows.append(["iterations", *("{} to {}".format(*c["iterations"]) for c in columns), ""])
    for process in columns[-1]["pss_mb"]:
        add(f"memory of {process}, MB", [c["pss_mb"].get(process, 0.0) for c in columns])
    for process in columns[-1]["files"]:
        add(f"open files of {process}", [c["files"].get(process, 0.0) for c in columns])
    for process in columns[-1]["threads"]:
        add(f"threads of {process}", [c["threads"].get(process, 0.0) for c in columns])
    add("wall time of an iteration, ms", [c["wall_ms"] for c in columns], 0)
    for process in columns[-1]["cpu_ms"]:
        add(f"processor time of {process}, ms", [c["cpu_ms"].get(process, 0.0) for c in columns])
    add("processor time, all, ms", [sum(c["cpu_ms"].values()) for c in columns])
    add("requests of an iteration", [c["requests"] for c in columns])
    add("requests of waiting processes, a second", [c["waiting_per_s"] for c in columns])
    add("sent to the bucket, KB an iteration", [c["sent_kb"] for c in columns])
    for kind in columns[-1]["disk_mb"]:
        add(f"disk, {kind}, MB", [c["disk_mb"].get(kind, 0.0) for c in columns])
    widths = [max(len(row[at]) for row in rows) for at in range(len(rows[0]))]
    return "\n".join(
        "  ".join(f"{cell:<{w}}" if at == 0 else f"{cell:>{w}}" for at, (cell, w) in each)
        for each in ([*enumerate(zip(row, widths, strict=True))] for row in rows)
    )


def verdicts(columns: list[dict[str, Any]]) -> dict[str, bool]:
    """Whether each bar holds from the second quarter to the last."""
    later = columns[1:]

    def spread(values: list[float]) -> float:
        return max(values) / min(values) - 1

    processes = later[-1]["pss_mb"]
    # Shrinking is no harm: PSS falls when other processes share the same pages.
    memory = {name: later[-1]["pss_mb"][name] / later[0]["pss_mb"][name] - 1 for name in processes}
    grown = {name: later[-1]["files"][name] - later[0]["files"][name] for name in processes}
    return {
        **{
            f"memory of {name} grows by at most 5 %": value <= BAR for name, value in memory.items()
        },
        **{f"open files of {name} flat": value < 1.0 for name, value in grown.items()},
        "wall time within 5 %": spread([c["wall_ms"] for c in later]) <= BAR,
        "processor time within 5 %": spread([sum(c["cpu_ms"].values()) for c in later]) <= BAR,
        "requests within 5 %": spread([c["requests"] for c in later]) <= BAR,
    }


def main() -> None:
    """Run the benchmark."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--iterations", type=int, default=10_000, help="most iterations")
    parser.add_argument("--minutes", type=float, default=60.0, help="longest time for them")
    parser.add_argument("--late", type=int, default=0, help="iterations to add before a resume")
    parser.add_argument("--late-minutes", type=float, default=3.0, help="time after the resume")
    parser.add_argument("--traces-mb", type=int, default=4096, help="DR_TRAIN_TRACES_MAX_MB")
    parser.add_argument("--json", action="store_true", help="print one JSON object at the end")
    parser.add_argument("--records", type=int, default=0, help="measure only so many records")
    given = parser.parse_args()
    result: dict[str, Any] = {}
    if given.records:
        result["records"] = record_growth.measure(given.records)
        for file, of_file in result["records"].items():
            for name in of_file[0]:
                values = "  ".join(f"{quarter[name]:9.2f}" for quarter in of_file)
                print(f"{file:22}{name:10}{values}")
        if given.json:
            print_json(result)
        return
    with workspace(given.traces_mb) as work:
        samples = watch(work, given.iterations, given.minutes)
        columns = quarters(samples)
        print(table(columns, ["first quarter", "second", "third", "fourth"]))
        result |= {"quarters": columns, "bars": verdicts(columns)}
        result["samples"] = [asdict(sample) for sample in samples]
        for bar, holds in result["bars"].items():
            print(f"{'holds' if holds else 'FAILS'}: {bar}")
        if given.late:
            age(work.data / "bucket", PREFIX, given.late)
            began_s = time.time()
            late = quarters(watch(work, given.late, given.late_minutes, "--resume"))
            result |= {"late": late, "resumed_s": time.time() - began_s}
            names = ["first quarter", "second", "third", "fourth"]
            print(f"\nAfter {given.late} more iterations:\n{table(late, names)}")
    if given.json:
        print_json(result)


if __name__ == "__main__":
    main()
