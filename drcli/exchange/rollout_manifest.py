"""The manifest of a rollout: what one worker drove, and its objects."""

from dataclasses import dataclass, field

from drcli.base.fingerprint import Fingerprint
from drcli.base.json_record import JsonRecord, RecordError
from drcli.exchange.checkpoint import checkpoint_name

LEAST_STEP_BYTES = 16
"""Action, log-probability, value, reward in 0.1.0."""


@dataclass(frozen=True)
class Part:
    key: str
    fingerprint: Fingerprint
    episodes: int
    steps: int

    def __post_init__(self) -> None:
        """Refuse claims beyond the bytes, before memory is reserved."""
        if not 0 < self.episodes <= self.steps <= self.fingerprint.size_bytes / LEAST_STEP_BYTES:
            raise RecordError(
                f"{self.fingerprint.size_bytes} bytes cannot hold {self.episodes} episodes of "
                f"{self.steps} steps"
            )


@dataclass(frozen=True)
class Driving:
    drive_s: float = 0.0
    evaluates: int | None = None
    reward_errors: int = 0
    discarded: int = 0

    def __post_init__(self) -> None:
        if self.drive_s < 0.0:
            raise RecordError(f"'drive_s' cannot be {self.drive_s}")


@dataclass(frozen=True)
class Manifest(JsonRecord):
    """What one worker drove; `rollbacks` happened before its checkpoint."""

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
        return sum(part.steps for part in self.parts)

    def is_of(self, session: str) -> bool:
        return belongs(self.session, session)


def session_of_worker(start: str, process: int, drive: int) -> str:
    return f"{start}-{process}-{drive}"


def belongs(worker_session: str, start: str) -> bool:
    return worker_session == start or worker_session.startswith(f"{start}-")
