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

    @property
    def trained_progress(self) -> list[float]:
        """Mean progress of each iteration of the last training, percent."""
        return [row["mean_progress"] for row in self.of("dr-start-training")[-1]["history"]]


def rules(results: Results, number: int = -1) -> list[str]:
    """Names of the problems that a check of the reward function reported."""
    report = results.of("dr-reward check")[number]
    return [problem["rule"] for problem in (*report["errors"], *report["warnings"])]


def drivers(results: Results) -> Mapping[str, Report]:
    """Those of the check, by name."""
    return {each["name"]: each for each in results.of("dr-reward check")[-1]["drivers"]}


PROMISES: Mapping[int, Mapping[str, Callable[[Results], bool]]] = {
    1: {
        "a slow lap earns more than a fast one": lambda r: (
            drivers(r)["steady"]["total"] > drivers(r)["fast"]["total"]
        ),
        "the steady driver earns more per step than the weaving one": lambda r: (
            drivers(r)["steady"]["mean"] > drivers(r)["weaving"]["mean"]
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
        "the weaving driver earns least for its lap": lambda r: (
            drivers(r)["weaving"]["total"]
            < min(drivers(r)[name]["total"] for name in ("steady", "fast"))
        ),
        "laps of the last evaluation below 15.5 s": lambda r: (
            statistics.mean(r.evaluated_laps_s[-1]) < 15.5
        ),
        "3 of 3 laps, the fastest below 13 s": lambda r: r.all_complete and min(r.laps_s) < 13.0,
    },
    4: {
        "the training ends within 60,000 steps": lambda r: r.trained_steps <= 60_000,
        "3 of 3 laps, the fastest below 11 s": lambda r: r.all_complete and min(r.laps_s) < 11.0,
    },
    5: {
        "progress is above 85 % in the last ten iterations": lambda r: (
            statistics.mean(r.trained_progress[-10:]) > 85.0
        ),
        "3 of 3 laps, the fastest below 8.5 s": lambda r: r.all_complete and min(r.laps_s) < 8.5,
    },
}
"""For each lesson, what one should see, and whether the results show it."""
