"""What a sweep keeps in the bucket: its trainings, how far each has come, and the best."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from drcli.base.json_record import JsonRecord

TrialState = Literal[
    "waiting", "running", "paused", "finished", "stopped early", "stopped", "failed"
]
"""State of a training of a sweep. "paused": another one has its turn; "stopped early": others were
better; "stopped": a person stopped it."""

Metric = Literal["lap_time", "progress", "reward"]
"""What decides which training is best."""

Resource = Literal["minutes", "steps", "episodes", "iterations"]
"""What the budget of a training counts."""

OVER: tuple[TrialState, ...] = ("finished", "stopped early", "stopped", "failed")
"""States in which the sweep does nothing more for a training."""


@dataclass(frozen=True)
class TrialScore:
    """How well the car of a training drives.

    Attributes:
        checkpoint: Number of the checkpoint whose evaluation this is; None without one.
        laps: Completed evaluation laps.
        episodes: Evaluation episodes; 0 if it was not evaluated yet.
        progress: Mean progress of the evaluation, percent; without one, of the best iteration.
        lap_s: Median time of the clean laps, simulated seconds; None without one.
        reward: Mean reward of an episode in the best iteration.
    """

    checkpoint: int | None = None
    laps: int = 0
    episodes: int = 0
    progress: float = 0.0
    lap_s: float | None = None
    reward: float | None = None


@dataclass(frozen=True)
class TrialRecord:
    """One training of a sweep.

    Attributes:
        name: Of its experiment and of its first model.
        prefix: Of the model that it trains now, in the bucket.
        run_id: Its DR_RUN_ID.
        varied: What distinguishes it from the others.
        hyperparameters: Those that differ from the file, once a population has changed them.
        source: Model whose weights it began with, in a population; empty for its own.
        amount: How much of the budget it has used.
        earlier: How much of that was used by the models that it trained before this one.
        starts: How often it was started again after a fault.
        message: Why it ended.
        remedy: What to do then.
        score: Null before its first iteration.
    """

    name: str
    prefix: str
    run_id: int
    varied: Mapping[str, str] = field(default_factory=dict)
    state: TrialState = "waiting"
    hyperparameters: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    amount: float = 0.0
    earlier: float = 0.0
    starts: int = 0
    message: str = ""
    remedy: str = ""
    score: TrialScore | None = None

    @property
    def is_over(self) -> bool:
        """Whether the sweep does nothing more for it."""
        return self.state in OVER


@dataclass(frozen=True)
class SweepRecord(JsonRecord):
    """A sweep. The command that runs it writes this after each change.

    Attributes:
        name: Of the sweep.
        metric: What decides which training is best: lap_time, progress or reward.
        resource: What the budget counts: minutes, steps, episodes or iterations.
        most: How much of it each training gets.
        began_at: When it began, Unix seconds.
        checks: How often the trainings were compared so far.
        ended_at: When all were over, Unix seconds; None before.
        best: Name of the best training; empty before the first result.
    """

    name: str
    metric: Metric
    resource: Resource
    most: float
    began_at: float
    trials: tuple[TrialRecord, ...]
    checks: int = 0
    ended_at: float | None = None
    best: str = ""
