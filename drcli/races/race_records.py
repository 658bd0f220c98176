"""The rules of a race, written by its organiser."""

from dataclasses import dataclass, field
from typing import Literal

from drcli.base.json_record import JsonRecord, RecordError, SafeInt, Seconds, Text, Words
from drcli.config.race_types import RaceKind
from drcli.records.iteration import is_clean_lap
from drcli.records.trace import STATUS_LABELS

Ranking = Literal["best-lap", "best-average", "total-time"]
Pairing = Literal["round-robin", "bracket"]


@dataclass(frozen=True)
class RaceRules(JsonRecord):
    """The rules of a race. Times of day are Unix seconds.

    Attributes:
        name: What it is called.
        created_at: When it was made.
        world: The track, as DR_WORLD_NAME names it.
        reverse: Whether it is driven against the direction of its name.
        race_type: As DR_RACE_TYPE.
        ranking: What decides: best-lap, best-average or total-time; pairs are decided by points.
        max_laps: Laps of each submission.
        min_laps: Complete laps needed to be ranked; in a row for best-average, all for total-time.
        average_laps: Consecutive complete laps whose mean counts for best-average.
        off_track_penalty_s: Added to the lap time whenever the car leaves the track, seconds.
        collision_penalty_s: The same for a collision, seconds.
        max_submissions: Submissions of one racer that count; 0 for any number.
        opens_at: When submissions are first taken; None if at once.
        closes_at: When no more are taken; None if it stays open.
        seed: Of all random numbers, the same for every submission.
        pairing: Who meets whom in HEAD_TO_MODEL.
        sensors: The only allowed sensors; empty for any.
        settings: Other settings of the laps, as texts by DR_ name: objects, disturbances.
        changes: How often the organiser has changed these rules.
    """

    name: str
    created_at: Seconds
    world: str
    reverse: bool = False
    race_type: RaceKind = "TIME_TRIAL"
    ranking: Ranking = "best-lap"
    max_laps: SafeInt = 3
    min_laps: SafeInt = 1
    average_laps: SafeInt = 3
    off_track_penalty_s: Seconds = 5.0
    collision_penalty_s: Seconds = 5.0
    max_submissions: SafeInt = 0
    opens_at: Seconds | None = None
    closes_at: Seconds | None = None
    seed: SafeInt = 0
    pairing: Pairing = "round-robin"
    sensors: list[str] = field(default_factory=list)
    settings: dict[str, str] = field(default_factory=dict)
    changes: SafeInt = 0

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise RecordError("'name' is empty")
        if not 1 <= self.min_laps <= self.max_laps or not 1 <= self.average_laps <= self.max_laps:
            raise RecordError("'min_laps' and 'average_laps' must be from 1 to 'max_laps'")
        if min(self.off_track_penalty_s, self.collision_penalty_s, self.max_submissions) < 0:
            raise RecordError("penalties and 'max_submissions' cannot be negative")

    @property
    def in_pairs(self) -> bool:
        """Whether submissions race each other."""
        return self.race_type == "HEAD_TO_MODEL"


# What a race keeps in the bucket about its submissions. Each record has one writer.


@dataclass(frozen=True)
class RaceSubmission(JsonRecord):
    """A submitted checkpoint, written by its racer after the model was copied."""

    racer: Words
    model: Text
    checkpoint: Text
    submitted_at: Seconds
    host: str = ""


@dataclass(frozen=True)
class QueueOrder(JsonRecord):
    """Where the organiser has put a submission.

    Attributes:
        place: At first microseconds.
        restarts: Results before the last one do not count.
    """

    place: SafeInt
    restarts: SafeInt = 0


@dataclass(frozen=True)
class DrivenLap:
    """One lap of a submission.

    Attributes:
        lap_s: Simulated seconds, penalties included.
        penalty_s: None if not recorded.
        immobilized: How often the car stood still for too long.
        reversed: How often it drove in the wrong direction.
    """

    lap_s: Seconds
    progress: float
    status: str
    off_track: SafeInt = 0
    crashes: SafeInt = 0
    resets: SafeInt = 0
    penalty_s: Seconds | None = None
    immobilized: SafeInt = 0
    reversed: SafeInt = 0

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
    restarts: SafeInt
    began_at: Seconds
    ended_at: Seconds | None = None
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
