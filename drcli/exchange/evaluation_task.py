"""One of several evaluations that share worker processes, and its outcome."""

from dataclasses import dataclass, field

from drcli.base.json_record import JsonRecord
from drcli.exchange.episode_metrics import TrialMetrics
from drcli.exchange.policy_source import PolicySource
from drcli.exchange.robust_result import RobustResult


@dataclass(frozen=True)
class EvaluationTask:
    """A model to evaluate on a track.

    Attributes:
        source: May name a file instead of the checkpoint.
        robust: Drive the grid of disturbances.
        fresh_laps: Laps from fresh starts instead; 0: none.
    """

    number: int
    prefix: str
    metrics_prefix: str
    checkpoint: str
    world: str
    stamp: str
    source: PolicySource = field(default_factory=PolicySource)
    robust: bool = False
    fresh_laps: int = 0

    @property
    def outcome_file(self) -> str:
        return f"outcome-{self.number}.json"


@dataclass(frozen=True)
class TaskOutcome(JsonRecord):
    """What came of a task; `reason` says why nothing could be driven."""

    trials: list[TrialMetrics] = field(default_factory=list)
    robust: RobustResult | None = None
    notes: list[str] = field(default_factory=list)
    reason: str = ""
    remedy: str = ""
    code: int = 0
