"""The manifest of a rollout: what one simulation worker drove, and the objects that hold it."""

from dataclasses import dataclass, field

from drcli.base.fingerprint import Fingerprint
from drcli.base.json_record import JsonRecord, Misfit
from drcli.exchange.checkpoint import checkpoint_name

LEAST_STEP_BYTES = 16
"""What a step takes at least: action, log-probability, value and reward, four bytes each as version
0.1.0 wrote them."""


@dataclass(frozen=True)
class Part:
    """One object with some of the episodes."""

    key: str
    fingerprint: Fingerprint
    episodes: int
    steps: int

    def __post_init__(self) -> None:
        """Refuse a part whose bytes cannot hold what it claims, before room is made for it.

        Raises:
            Misfit: They cannot.
        """
        if not 0 < self.episodes <= self.steps <= self.fingerprint.size_bytes / LEAST_STEP_BYTES:
            raise Misfit(
                f"{self.fingerprint.size_bytes} bytes cannot hold {self.episodes} episodes of "
                f"{self.steps} steps"
            )


@dataclass(frozen=True)
class Driving:
    """How a worker drove its episodes.

    Attributes:
        drive_s: Wall time.
        evaluates: Number of the checkpoint that it evaluates beside them, None without one.
    """

    drive_s: float = 0.0
    evaluates: int | None = None

    def __post_init__(self) -> None:
        if self.drive_s < 0.0:
            raise Misfit(f"'drive_s' cannot be {self.drive_s}")


@dataclass(frozen=True)
class Manifest(JsonRecord):
    """What one worker drove in one iteration.

    Attributes:
        iteration: Which.
        worker: Who drove.
        checkpoint: Name of the checkpoint that drove.
        session: Start of the training, and of the worker in it, that wrote it.
        parts: Objects with the episodes, in the order in which they were driven.
        notes: How they were driven.
    """

    iteration: int
    worker: int
    checkpoint: str
    session: str
    parts: tuple[Part, ...] = ()
    notes: Driving = field(default_factory=Driving)

    def __post_init__(self) -> None:
        checkpoint_name(self.checkpoint)

    @property
    def steps(self) -> int:
        """Number of steps in all parts."""
        return sum(part.steps for part in self.parts)

    def is_of(self, session: str) -> bool:
        """Whether a worker of this start of the training wrote it."""
        return belongs(self.session, session)


def session_of_worker(start: str, process: int, drive: int) -> str:
    """What a worker calls what it writes: no other drive of any start is called so.

    Args:
        start: Session of the training.
        process: Of the worker.
        drive: Counts its drives.
    """
    return f"{start}-{process}-{drive}"


def belongs(worker_session: str, start: str) -> bool:
    """Whether something was written by a worker of this start of a training."""
    return worker_session == start or worker_session.startswith(f"{start}-")
