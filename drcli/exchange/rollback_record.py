"""How often and why a training went back to an older checkpoint."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from drcli.base.json_record import JsonRecord
from drcli.exchange.checkpoint import CheckpointName, CheckpointRecord, checkpoint_name

RATE_FACTOR = 1.0 / 3.0
Reason = Literal["nan", "collapse"]


@dataclass(frozen=True)
class Rollback:
    """One return to an older checkpoint.

    Attributes:
        at: Unix seconds.
        reason: A loss or weight that is NaN or infinite, or a policy that is far worse.
        text: What was wrong, a sentence without its full stop.
        left: Name of the checkpoint that was the newest.
        target: Name of the checkpoint from which the training goes on.
        lr: `lr` of hyperparameters.json at that time.
        factor: The learning rate since then, as a share of `lr`.
        elapsed_s: Wall time of training until then, with the given up iterations.
        session: The start that went back.
    """

    at: float
    reason: Reason
    text: str
    left: str
    target: str
    lr: float
    factor: float
    elapsed_s: float
    session: str = ""

    def __post_init__(self) -> None:
        checkpoint_name(self.left)
        checkpoint_name(self.target)

    @property
    def sentence(self) -> str:
        """For people."""
        left, target = checkpoint_name(self.left), checkpoint_name(self.target)
        if left.number == target.number:
            back = f"The update of checkpoint {target.number} is repeated"
        else:
            back = f"Went back from checkpoint {left.number} to {target.number}"
        return f"{self.text}. {back} with a learning rate of {self.lr * self.factor:.3g}."

    def facts(self) -> Mapping[str, object]:
        """For programs, in the journal."""
        return {
            "reason": self.reason,
            "left": self.left,
            "target": self.target,
            "learning_rate": self.lr * self.factor,
        }


@dataclass(frozen=True)
class Rollbacks(JsonRecord):
    """All rollbacks of a model, oldest first. Only its trainer writes them.

    A rollback happens when it is written here; a trainer that starts in between completes it.
    Checkpoints and rollouts count the rollbacks before them, so nothing given up seems new.
    """

    entries: list[Rollback] = field(default_factory=list)

    @property
    def count(self) -> int:
        return len(self.entries)

    @property
    def elapsed_s(self) -> float:
        return self.entries[-1].elapsed_s if self.entries else 0.0

    def factor(self, lr: float) -> float:
        """Of `lr`; 1 once somebody changed it."""
        last = self.entries[-1] if self.entries else None
        return 1.0 if last is None or last.lr != lr else last.factor

    def pending(self, newest: CheckpointRecord) -> CheckpointName | None:
        """Where to go on, if the newest checkpoint was given up."""
        if not self.entries or (newest.counters.rollbacks or 0) >= self.count:
            return None
        target = checkpoint_name(self.entries[-1].target)
        return target if newest.number > target.number else None

    def allows(self, checkpoint: int, rollbacks: int) -> bool:
        """Whether a checkpoint, published after so many, still counts."""
        later = self.entries[max(0, rollbacks) :]
        return all(checkpoint <= checkpoint_name(each.target).number for each in later)


NO_ROLLBACKS = Rollbacks()
