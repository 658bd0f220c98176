"""What a race keeps in the bucket about its submissions. Each record has one writer."""

from dataclasses import dataclass, field
from typing import Literal

from drcli.base.json_record import JsonRecord, RecordError
from drcli.exchange.laps import is_clean_lap
from drcli.exchange.trace import STATUS_LABELS


@dataclass(frozen=True)
class RaceSubmission(JsonRecord):
    """A submitted checkpoint, written by its racer after the model was copied."""

    racer: str
    model: str
    checkpoint: str
    submitted_at: float
    host: str = ""

    def __post_init__(self) -> None:
        if not self.racer.strip() or not self.model or not self.checkpoint:
            raise RecordError("'racer', 'model' and 'checkpoint' cannot be empty")


@dataclass(frozen=True)
class QueueOrder(JsonRecord):
    """Where the organiser has put a submission.

    Attributes:
        place: At first microseconds.
        restarts: Results before the last one do not count.
    """

    place: int
    restarts: int = 0


@dataclass(frozen=True)
class DrivenLap:
    """One lap of a submission.

    Attributes:
        lap_s: Simulated seconds, penalties included.
        penalty_s: None if not recorded.
        immobilized: How often the car stood still for too long.
        reversed: How often it drove in the wrong direction.
    """

    lap_s: float
    progress: float
    status: str
    off_track: int = 0
    crashes: int = 0
    resets: int = 0
    penalty_s: float | None = None
    immobilized: int = 0
    reversed: int = 0

    @property
    def complete(self) -> bool:
        """With or without resets, as the reference counts."""
        return self.status == STATUS_LABELS["lap_complete"]

    @property
    def clean(self) -> bool:
        violations = self.off_track, self.crashes, self.immobilized, self.reversed
        return is_clean_lap(self.complete, *violations, self.resets, self.penalty_s)


@dataclass(frozen=True)
class DrivenCar:
    """What one car of an evaluation drove; keys in the bucket."""

    submission: str
    laps: list[DrivenLap]
    simtrace: str = ""
    metrics: str = ""
    video: str = ""


@dataclass(frozen=True)
class RaceResult(JsonRecord):
    """The evaluation of a submission or pair, written by the queue.

    Attributes:
        session: The run of the queue.
        restarts: Of its submissions when it began.
        notes: Such as why there is no video.
    """

    state: Literal["running", "done", "failed"]
    session: str
    restarts: int
    began_at: float
    ended_at: float | None = None
    cars: list[DrivenCar] = field(default_factory=list)
    message: str = ""
    remedy: str = ""
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.state == "done" and not self.cars:
            raise RecordError("a result that is done needs 'cars'")


@dataclass(frozen=True)
class BracketDraw(JsonRecord):
    """The first meets the last."""

    seeds: list[str]
