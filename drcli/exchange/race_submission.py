"""What a race keeps in the bucket about its submissions. Each record has one writer."""

from dataclasses import dataclass, field
from typing import Literal

from drcli.base.json_record import JsonRecord, RecordError
from drcli.exchange.laps import is_clean_lap
from drcli.exchange.trace import STATUS_LABELS


@dataclass(frozen=True)
class RaceSubmission(JsonRecord):
    """A checkpoint that a racer submitted. Its racer writes it once, after the model was copied.

    Attributes:
        racer: Who submitted it.
        model: Prefix of the model that it was copied from.
        checkpoint: Name of the checkpoint.
        submitted_at: When, Unix seconds.
        host: The machine from which it came.
    """

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
    """Where the organiser has put a submission, and how often it was restarted.

    Attributes:
        place: The queue is in the order of these numbers; microseconds of its submission at first.
        restarts: How often it is to be driven again; older results no longer count.
    """

    place: int
    restarts: int = 0


@dataclass(frozen=True)
class DrivenLap:
    """One lap of a submission.

    Attributes:
        lap_s: Simulated seconds, penalties included.
        progress: Percent of the lap.
        status: How it ended, such as "Lap complete".
        off_track: How often the car left the track.
        crashes: How often it crashed.
        resets: How often it was put back on the track.
        penalty_s: Penalties in the time; None if nobody recorded them.
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
        """Whether the lap was completed, with or without resets, as the reference counts it."""
        return self.status == STATUS_LABELS["lap_complete"]

    @property
    def clean(self) -> bool:
        """Whether it is a clean lap."""
        violations = self.off_track, self.crashes, self.immobilized, self.reversed
        return is_clean_lap(self.complete, *violations, self.resets, self.penalty_s)


@dataclass(frozen=True)
class DrivenCar:
    """What one car of an evaluation drove.

    Attributes:
        submission: Whose car it is.
        laps: In the order in which they were driven.
        simtrace: Key of the trace in the bucket.
        metrics: Key of the metrics in the bucket.
        video: Key of the video in the bucket; empty without one.
    """

    submission: str
    laps: list[DrivenLap]
    simtrace: str = ""
    metrics: str = ""
    video: str = ""


@dataclass(frozen=True)
class RaceResult(JsonRecord):
    """What became of the evaluation of a submission, or of a pair. The queue writes it.

    Attributes:
        state: What happened last.
        session: The run of the queue that drove it.
        restarts: Of its submissions together when it began.
        began_at: When it began, Unix seconds.
        ended_at: When it ended; None while it runs.
        cars: What each car drove; empty unless it is done.
        message: Why it failed.
        remedy: What to do about that.
        notes: What is worth knowing, such as why there is no video.
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
    """The order in which submissions enter a bracket, drawn when its first pair is driven.

    Attributes:
        seeds: Submissions; the first meets the last.
    """

    seeds: list[str]
