"""How long a training takes to start: from the command to the first step of a car.

    python scripts/bench start [--runs 5] [--against CHECKOUT] [--json]

Each run starts a new model with the shipped files, with the real command and the embedded bucket,
and stops it at its first step. With --against, another checkout of this project is measured in
turn, with the same libraries. The first run of each checkout fills the caches and does not count.
With --json the last line of stdout is one object with the runs of each checkout and their medians:

    command_s    from the command until its supervisor starts the workers: imports, checks, files
    trainer_s    until the trainer begins
    sim_s        until the simulation worker begins
    step_s       until the cars have made their first step
    processor_s  processor time until then, of the command, its checks, and all it has started
"""

import argparse
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import psutil
from machine import print_json

from drcli.bucket.server import server

PROJECT = Path(__file__).resolve().parents[2]

FIGURES = ("command_s", "trainer_s", "sim_s", "step_s", "processor_s")

LONGEST_S = 90.0
"""A start that takes longer has failed."""

POLL_S = 0.02

CALLS = "calls.txt"

NOTE = f"""

_given = reward_function


def reward_function(params):
    import time

    with open("{CALLS}", "a") as file:
        file.write(f"{{time.time()}}\\n")
    return _given(params)
"""
"""Added to the reward function: it notes when it is called, which is after each step."""


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(prog="bench start", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=5, help="starts of each checkout")
    parser.add_argument("--against", type=Path, help="another checkout, measured in turn")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    checkouts = {"this": PROJECT}
    if options.against is not None:
        checkouts["other"] = options.against.resolve()
    runs: dict[str, list[dict[str, float]]] = {name: [] for name in checkouts}
    with tempfile.TemporaryDirectory(prefix="bench-start-") as place:
        starts = {name: Starts(path, Path(place, name)) for name, path in checkouts.items()}
        try:
            for number in range(options.runs + 1):
                for name, start in starts.items():
                    run = start.measured(number)
                    if number:
                        runs[name].append(run)
                        print(f"{name} {number}: {run}", file=sys.stderr, flush=True)
        finally:
            for start in starts.values():
                start.stop_storage()
    medians = {
        name: {each: round(statistics.median(run[each] for run in measured), 2) for each in FIGURES}
        for name, measured in runs.items()
    }
    if options.json:
        print_json({"runs": runs, "median": medians})
    else:
        print("".join(f"{each:>14}" for each in ("", *FIGURES)))
        for name, found in medians.items():
            print(f"{name:>14}" + "".join(f"{found[each]:14.2f}" for each in FIGURES))


class Starts:
    """Starts trainings of one checkout in a working folder of its own."""

    def __init__(self, checkout: Path, folder: Path) -> None:
        self._folder = folder
        own = folder / "custom_files"
        own.mkdir(parents=True)
        for name in ("run.env", "system.env"):
            shutil.copy(checkout / name, folder)
        for path in (checkout / "defaults").glob("*.*"):
            shutil.copy(path, own)
        with (own / "reward_function.py").open("a") as file:
            file.write(NOTE)
        kept = {name: value for name, value in os.environ.items() if not name.startswith("DR_")}
        search = os.pathsep.join([str(checkout), str(checkout / "env")])
        self._environment = {**kept, "PYTHONPATH": search}

    def measured(self, number: int) -> dict[str, float]:
        """Start a training, stop it at its first step, and tell what was measured."""
        self._environment["DR_LOCAL_S3_MODEL_PREFIX"] = prefix = f"start-{number}"
        (self._folder / CALLS).unlink(missing_ok=True)
        logs = self._folder / "data" / "logs"
        supervisor = logs / "sagemaker" / prefix / "supervisor.log"
        trainer = logs / "sagemaker" / prefix / "trainer.log"
        sim = logs / "robomaker" / prefix / "sim-0.log"
        began_s = time.time()
        command = self._dr("start-training", "-q")
        _, status, used = os.wait4(command.pid, 0)
        command.returncode = os.waitstatus_to_exitcode(status)
        if command.returncode:
            raise SystemExit(f"The command ended with exit code {command.returncode}.")
        try:
            planned_s = _logged(supervisor, r"started as process", began_s)
            trainer_s = _logged(trainer, r"trainer started", began_s)
            sim_s = _logged(sim, r"sim-0 started", began_s)
            stepped_s = self._first_step(planned_s)
            processor_s = used.ru_utime + used.ru_stime + _spent(supervisor)
        finally:
            self._dr("stop-training").wait()
        times = (planned_s, trainer_s, sim_s, stepped_s)
        figures = (*(each - began_s for each in times), processor_s)
        return {name: round(each, 3) for name, each in zip(FIGURES, figures, strict=True)}

    def stop_storage(self) -> None:
        """Stop the embedded bucket."""
        server.stop_default(self._folder)

    def _dr(self, *arguments: str) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(
            [sys.executable, "-P", "-c", "from drcli.cli.program import main; main()", *arguments],
            cwd=self._folder,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def _first_step(self, planned_s: float) -> float:
        """When the reward function was first called after the checks had called it."""
        while time.time() < planned_s + LONGEST_S:
            with suppress(FileNotFoundError):
                for line in (self._folder / CALLS).read_text().splitlines():
                    if float(line) > planned_s:
                        return float(line)
            time.sleep(POLL_S)
        raise SystemExit("The cars made no step.")


def _logged(log: Path, what: str, began_s: float) -> float:
    """When a line was written to a log."""
    while time.time() < began_s + LONGEST_S:
        text = log.read_text("utf-8", "replace") if log.exists() else ""
        if found := re.search(rf"^(\S+)Z INFO .*{what}", text, re.MULTILINE):
            return datetime.fromisoformat(f"{found[1]}+00:00").timestamp()
        time.sleep(POLL_S)
    raise SystemExit(f"{log} has no line with '{what}'.")


def _spent(log: Path) -> float:
    """Processor time of the processes that a supervisor has started, and its own."""
    pids = re.findall(r"started as process (\d+)", log.read_text("utf-8", "replace"))
    spent: list[float] = []
    with suppress(psutil.Error):
        own = psutil.Process(int(pids[0])).parent()
        processes: list[Any] = [] if own is None else [own, *own.children(recursive=True)]
        for each in processes:
            times = each.cpu_times()
            spent += [times.user, times.system]
    return sum(spent)


if __name__ == "__main__":
    main()
