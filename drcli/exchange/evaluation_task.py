"""One of several evaluations that share worker processes, and what came of it."""

from dataclasses import dataclass, field

from drcli.base.json_record import JsonRecord
from drcli.exchange.episode_metrics import TrialMetrics
from drcli.exchange.policy_source import PolicySource
from drcli.exchange.robust_result import RobustResult


@dataclass(frozen=True)
class EvaluationTask:
    """A model to evaluate on a track.

    Attributes:
        number: From 0, in the order of the command.
        prefix: Model prefix.
        metrics_prefix: Where its metrics go.
        checkpoint: Name of the checkpoint or file.
        world: The track.
        stamp: Fourteen digits that name this evaluation among those of the model.
        source: May name a file that drives instead.
        robust: Whether to drive the grid of disturbances instead of the trials of the settings.
        fresh_laps: How many laps from fresh starts to drive instead; 0 for none.
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
        """Name of the file with its outcome, in the folder of the job."""
        return f"outcome-{self.number}.json"


@dataclass(frozen=True)
class TaskOutcome(JsonRecord):
    """What came of a task.

    Attributes:
        trials: Of the settings; empty for a robust evaluation.
        robust: Of a robust evaluation.
        notes: What was driven otherwise than asked.
        reason: Why nothing could be driven; empty if it was.
        remedy: What to do about it.
        code: Exit code of a command that ends with this reason.
    """

    trials: list[TrialMetrics] = field(default_factory=list)
    robust: RobustResult | None = None
    notes: list[str] = field(default_factory=list)
    reason: str = ""
    remedy: str = ""
    code: int = 0
