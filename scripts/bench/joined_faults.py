"""What a machine costs that has joined a training and is killed, cut off, or ten times as slow.

The reward function sleeps, so that the machines do not share the processor, and the policy stays as
it is, so that all iterations are equal. One training meets one fault after the other. A fault costs
at most the share of its machine if there are still (N - 1)/N of the steps per second.
"""

import argparse
import json
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

from joined import Machine, Training, kind_of_network
from machine import facts

from drcli.model.history import read_history
from drcli.model.model_store import ModelStore

ROUND_TRIPS_S = (0.001, 0.02, 0.1, 0.005)
SLEEP_S = 0.1
EPISODES = 40
SLOWER = 10
CUT_S = 60.0
SKIPPED = 3
"""First iterations with all machines: the speed of a worker counts only after so many."""

FACTOR = "BENCH_SLEEP_FACTOR"
"""Variable with the file that says how many times as long a machine sleeps."""

_REWARD = f"""
import os
import time

def reward_function(params):
    try:
        with open(os.environ["{FACTOR}"]) as file:
            factor = float(file.read())
    except (KeyError, OSError, ValueError):
        factor = 1.0
    time.sleep({SLEEP_S} * factor)
    return 1.0
"""


def equal_iterations(custom: Path) -> None:
    """Let each step cost sleep, and the policy stay as it is."""
    (custom / "reward_function.py").write_text(_REWARD)
    path = custom / "hyperparameters.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "lr": 1e-8}))


class Observer:
    """Notes when each checkpoint appeared. Close it when done."""

    def __init__(self, training: Training) -> None:
        self._training = training
        self._over = threading.Event()
        self.seen: list[tuple[float, int, int]] = []
        """Time, number and steps of each checkpoint."""
        self.shares: list[tuple[float, list[int]]] = []
        """Time and episodes of each worker, where that has changed."""
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._over.wait(0.25):
            iterations, steps = self._training.done()
            if not self.seen or self.seen[-1][1] != iterations:
                self.seen.append((time.monotonic(), iterations, steps))
            shares = self._training.shares()
            if not self.shares or self.shares[-1][1] != shares:
                self.shares.append((time.monotonic(), shares))

    def steps_at(self, moment_s: float) -> float:
        """Steps learned from until a moment, between two checkpoints by a straight line."""
        before = [each for each in self.seen if each[0] <= moment_s][-1]
        later = [each for each in self.seen if each[0] > moment_s]
        if not later:
            return float(before[2])
        share = (moment_s - before[0]) / (later[0][0] - before[0])
        return before[2] + share * (later[0][2] - before[2])

    def speed(self, began_s: float, ended_s: float) -> float:
        """Steps per second between two moments; waits for the checkpoint after the second one."""
        while self.seen[-1][0] <= ended_s:
            time.sleep(0.25)
        return (self.steps_at(ended_s) - self.steps_at(began_s)) / (ended_s - began_s)

    def longest(self, began_s: float, ended_s: float) -> float:
        """Longest time from one checkpoint to the next that lies in this time in part, seconds."""
        times = [each[0] for each in self.seen]
        return max(
            later - earlier
            for earlier, later in pairwise(times)
            if later > began_s and earlier < ended_s
        )

    def close(self) -> None:
        """Note nothing more."""
        self._over.set()
        self._thread.join()


class Trial:
    """One training with machines whose faults are measured.

    Args:
        training: Has begun.
        seconds: Of each measurement.
    """

    def __init__(self, training: Training, seconds: float) -> None:
        self._training = training
        self._seconds = seconds
        self._factors = [training.folder / f"factor-{k}" for k in range(len(ROUND_TRIPS_S))]
        self._machines: list[Machine] = [
            training.join(f"far-{k}", each, {FACTOR: str(self._factors[k])})
            for k, each in enumerate(ROUND_TRIPS_S)
        ]
        self._observer = Observer(training)

    def measure(self, faults: list[str]) -> list[dict[str, Any]]:
        """One fault after the other; the machine that is killed comes last."""
        count = len(self._machines)
        self._training.wait_for(lambda: self._training.drivers() == count, 300.0)
        first = self._training.done()[0] + SKIPPED
        self._training.wait_for(lambda: self._training.done()[0] >= first, 300.0)
        rows = []
        if "slow" in faults:
            rows.append(self._row("10 times as slow", self._slow, self._fast))
        if "cut" in faults:
            rows.append(self._row(f"cut off for {CUT_S:.0f} s", self._cut, None))
        if "killed" in faults:
            rows.append(self._row("killed", self._machines[0].kill, None, returns=False))
        return rows

    def close(self) -> None:
        """End the observation."""
        self._observer.close()

    def _slow(self) -> None:
        self._factors[3].write_text(str(SLOWER))

    def _fast(self) -> None:
        self._factors[3].write_text("1")

    def _cut(self) -> None:
        machine = self._machines[1]
        machine.cut(off=True)
        threading.Timer(CUT_S, lambda: machine.cut(off=False)).start()

    def _row(
        self,
        name: str,
        begin: Callable[[], object],
        end: Callable[[], object] | None,
        *,
        returns: bool = True,
    ) -> dict[str, Any]:
        """Measure before and during a fault, and how long its machine then needs to come back."""
        before_s = time.monotonic()
        time.sleep(self._seconds / 2.0)
        began_s = time.monotonic()
        before = self._observer.speed(before_s, began_s)
        usual_s = self._observer.longest(before_s, began_s)
        began_s = time.monotonic()
        begin()
        time.sleep(self._seconds)
        ended_s = time.monotonic()
        over_s = began_s + CUT_S if begin == self._cut else ended_s
        if end is not None:
            end()
        row: dict[str, Any] = {"fault": name, "steps/s before": round(before, 2)}
        if returns:
            self._training.wait_for(self._is_equal, 600.0)
            back_s = max(self._observer.shares[-1][0], over_s)
            row["back after s"] = round(back_s - over_s, 1)
        during = self._observer.speed(began_s, ended_s)
        return {
            **row,
            "steps/s": round(during, 2),
            "share": round(during / before, 3),
            "at least": round(1.0 - 1.0 / len(self._machines), 3),
            "longest iteration s": round(self._observer.longest(began_s, ended_s), 1),
            "longest before s": round(usual_s, 1),
            "shares": [
                (round(moment_s - began_s, 1), counts)
                for moment_s, counts in self._observer.shares
                if moment_s >= began_s
            ],
        }

    def _is_equal(self) -> bool:
        """Whether all machines have equal shares again."""
        counts = self._observer.shares[-1][1]
        return len(counts) == len(self._machines) and max(counts) - min(counts) <= 1


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=120.0, help="of each measurement")
    parser.add_argument("--faults", nargs="+", default=["slow", "cut", "killed"])
    parser.add_argument("--keep", type=Path, help="folder for the files of the training")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that namespaces are deleted
    network = kind_of_network()
    with tempfile.TemporaryDirectory(prefix="faults-") as temporary:
        folder = arguments.keep or Path(temporary)
        folder.mkdir(exist_ok=True, parents=True)
        settings = {"DR_TRAIN_OVERLAP": "off", "DR_TRAIN_EVAL_SHARE": "0.001"}
        training = Training(folder, EPISODES, 0, equal_iterations, settings)
        try:
            trial = Trial(training, arguments.seconds)
            try:
                rows = trial.measure(arguments.faults)
            finally:
                trial.close()
            iterations = read_history(ModelStore(training.bucket(), "joined"))
        finally:
            training.close()
    result = {
        "network": network,
        "faults": rows,
        "iterations": [(each.iteration, each.steps, each.elapsed_s) for each in iterations],
        "machine": facts(),
    }
    if arguments.json:
        print(json.dumps(result))
        return
    print(network)
    for row in rows:
        print("  ".join(f"{name} {value}" for name, value in row.items()))


if __name__ == "__main__":
    main()
