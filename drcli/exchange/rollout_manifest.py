"""The manifest of a rollout: what one simulation worker drove, and in which objects it is."""

from dataclasses import dataclass, field

from drcli.base.fingerprint import Fingerprint
from drcli.base.json_record import JsonRecord, RecordError
from drcli.exchange.checkpoint import checkpoint_name

LEAST_STEP_BYTES = 16
"""Least size of a step: action, log-probability, value and reward, four bytes each in 0.1.0."""


@dataclass(frozen=True)
class Part:
    """One object with some of the episodes."""

    key: str
    fingerprint: Fingerprint
    episodes: int
    steps: int

    def __post_init__(self) -> None:
        """Refuse a part that claims more than its bytes can hold, before memory is reserved."""
        if not 0 < self.episodes <= self.steps <= self.fingerprint.size_bytes / LEAST_STEP_BYTES:
            raise RecordError(
                f"{self.fingerprint.size_bytes} bytes cannot hold {self.episodes} episodes of "
                f"{self.steps} steps"
            )


@dataclass(frozen=True)
class Driving:
    """How a worker drove its episodes.

    Attributes:
        drive_s: Wall time.
        evaluates: Number of the checkpoint that it evaluates at the same time, or None.
        reward_errors: Calls of the reward function that failed and were counted.
        discarded: Episodes that the reward function declared broken; they are in no part.
    """

    drive_s: float = 0.0
    evaluates: int | None = None
    reward_errors: int = 0
    discarded: int = 0

    def __post_init__(self) -> None:
        if self.drive_s < 0.0:
            raise RecordError(f"'drive_s' cannot be {self.drive_s}")


@dataclass(frozen=True)
class Manifest(JsonRecord):
    """What one worker drove in one iteration with one checkpoint.

    Attributes:
        session: Of the worker, as in `session_of_worker`.
        rollbacks: How often the training had gone back when its checkpoint was published.
        parts: Objects with the episodes, in the order in which they were driven.
    """

    iteration: int
    worker: int
    checkpoint: str
    session: str
    parts: tuple[Part, ...] = ()
    notes: Driving = field(default_factory=Driving)
    rollbacks: int = 0

    def __post_init__(self) -> None:
        checkpoint_name(self.checkpoint)

    @property
    def steps(self) -> int:
        """Of all parts together."""
        return sum(part.steps for part in self.parts)

    def is_of(self, session: str) -> bool:
        """Whether a worker of this start of the training wrote it."""
        return belongs(self.session, session)


def session_of_worker(start: str, process: int, drive: int) -> str:
    """A name for what a worker writes, which no other drive of any start of the training has.

    Args:
        start: Session of the training.
        process: Process number of the worker.
        drive: Counts its drives.
    """
    return f"{start}-{process}-{drive}"


def belongs(worker_session: str, start: str) -> bool:
    """Whether the session of a worker is one of this start of a training."""
    return worker_session == start or worker_session.startswith(f"{start}-")
