"""What each lesson promises, as checks of what its commands printed.

The section "What you should see" of its page says the same; a test compares the numbers.
"""

import json
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Report = Mapping[str, Any]


@dataclass(frozen=True)
class Results:
    """The reports of a lesson's commands, in the order of the page.

    Attributes:
        reports: Name of the command, and its report.
    """

    reports: tuple[tuple[str, Report], ...]

    @staticmethod
    def read(folder: Path) -> "Results":
        """The reports that the commands left in a folder."""
        found = []
        for path in sorted(folder.iterdir()):
            lines = [line for line in path.read_text("utf-8").splitlines() if line.startswith("{")]
            if lines:
                found.append((path.name.partition("-")[2], json.loads(lines[-1])))
        return Results(tuple(found))

    def of(self, command: str) -> list[Report]:
        """All reports of a command such as `dr-evaluate`, in order."""
        return [report for name, report in self.reports if name == command.replace(" ", "-")]

    @property
    def trained_steps(self) -> int:
        """Environment steps of the last training."""
        return sum(row["steps"] for row in self.of("dr-start-training")[-1]["history"])

    @property
    def laps_s(self) -> list[float]:
        """Times of the completed laps of the last evaluation."""
        trials = self.of("dr-evaluate")[-1]["trials"]
        return [trial["lap_s"] for trial in trials if trial["status"] == "Lap complete"]

    @property
    def all_complete(self) -> bool:
        """Whether the last evaluation completed all its laps."""
        return len(self.laps_s) == len(self.of("dr-evaluate")[-1]["trials"])

    @property
    def evaluated_laps_s(self) -> list[list[float]]:
        """Lap times of the evaluations in the last training, where any lap was completed."""
        rows = self.of("dr-start-training")[-1]["history"]
        return [row["evaluation_lap_s"] for row in rows if row["evaluation_lap_s"]]


def rules(results: Results, number: int = -1) -> list[str]:
    """Names of the problems that a check of the reward function reported."""
    report = results.of("dr-reward check")[number]
    return [problem["rule"] for problem in (*report["errors"], *report["warnings"])]


def per_step(results: Results, driver: str) -> float:
    """Mean reward of a driver of the check."""
    drivers = {each["name"]: each for each in results.of("dr-reward check")[-1]["drivers"]}
    return float(drivers[driver]["mean"])


PROMISES: Mapping[int, Mapping[str, Callable[[Results], bool]]] = {
    1: {
        "the check has one warning: slow laps earn more": lambda r: rules(r) == ["standing"],
        "the steady driver earns more per step than the weaving one": lambda r: (
            per_step(r, "steady") > per_step(r, "weaving")
        ),
        "the training ends within 15,000 steps": lambda r: r.trained_steps <= 15_000,
        "3 of 3 laps, the fastest below 17 s": lambda r: r.all_complete and min(r.laps_s) < 17.0,
    },
    2: {
        "the check warns that the reward is constant": lambda r: "constant" in rules(r, 0),
        "the laps get at least 1 s slower while it trains": lambda r: (
            statistics.mean(r.evaluated_laps_s[-1]) > statistics.mean(r.evaluated_laps_s[0]) + 1.0
        ),
    },
    3: {
        "the check has no warning": lambda r: rules(r) == [],
        "the training ends within 20,000 steps": lambda r: r.trained_steps <= 20_000,
        "3 of 3 laps, the fastest below 12.8 s": lambda r: r.all_complete and min(r.laps_s) < 12.8,
    },
    4: {
        "the training ends within 60,000 steps": lambda r: r.trained_steps <= 60_000,
        "3 of 3 laps, the fastest below 11 s": lambda r: r.all_complete and min(r.laps_s) < 11.0,
    },
    5: {
        "the best lap is below 10 s": lambda r: bool(r.laps_s) and min(r.laps_s) < 10.0,
        "3 of 3 laps": lambda r: r.all_complete,
    },
}
"""For each lesson, what one should see, and whether the results show it."""
