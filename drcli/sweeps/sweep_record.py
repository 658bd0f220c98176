"""What a sweep keeps in the bucket."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from drcli.base.json_record import JsonRecord, SafeInt, Seconds

TrialState = Literal[
    "waiting", "running", "paused", "finished", "stopped early", "stopped", "failed"
]
""""paused": another has its turn; "stopped early": others were better."""

Metric = Literal["lap_time", "progress", "reward"]
Resource = Literal["minutes", "steps", "episodes", "iterations"]
OVER: tuple[TrialState, ...] = ("finished", "stopped early", "stopped", "failed")


@dataclass(frozen=True)
class TrialScore:
    """How well the car of a training drives.

    Attributes:
        progress: Of the evaluation, else of the best iteration, percent.
        lap_s: Median of clean laps, simulated seconds.
        reward: In the best iteration.
    """

    checkpoint: SafeInt | None = None
    laps: SafeInt = 0
    episodes: SafeInt = 0
    progress: float = 0.0
    lap_s: Seconds | None = None
    reward: float | None = None


@dataclass(frozen=True)
class TrialRecord:
    """One training of a sweep.

    Attributes:
        prefix: Of its present model.
        hyperparameters: Changed by a population.
        source: In a population, whose weights it began with.
        amount: Used budget.
        earlier: Used by its earlier models.
        starts: Restarts after faults.
    """

    name: str
    prefix: str
    run_id: SafeInt
    varied: Mapping[str, str] = field(default_factory=dict)
    state: TrialState = "waiting"
    hyperparameters: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    amount: float = 0.0
    earlier: float = 0.0
    starts: SafeInt = 0
    message: str = ""
    remedy: str = ""
    score: TrialScore | None = None

    @property
    def is_over(self) -> bool:
        return self.state in OVER


@dataclass(frozen=True)
class SweepRecord(JsonRecord):
    """Written after each change by its command; `most` is each training's budget."""

    name: str
    metric: Metric
    resource: Resource
    most: float
    began_at: Seconds
    trials: tuple[TrialRecord, ...]
    checks: SafeInt = 0
    ended_at: Seconds | None = None
    best: str = ""


# Keys of sweeps in the bucket.


FOLDER = "sweeps/"


def sweep_key(name: str) -> str:
    return f"{FOLDER}{name}.json"


def sweep_of(key: str) -> str | None:
    found = re.fullmatch(r"sweeps/([a-z0-9-]+)\.json", key)
    return found[1] if found else None
