"""What a trace does not tell about an evaluation, to film it later."""

from dataclasses import dataclass, field

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class RecordedObjects(JsonRecord):
    """What stood and drove around the car in one episode of a trace.

    Attributes:
        poses: x and y in metres, yaw in radians, by row of the episode and object; a single row if
            nothing moved.
    """

    episode: int
    poses: list[list[list[float]]]


@dataclass(frozen=True)
class RaceRecording(JsonRecord):
    """What a film needs besides a trace; `shapes` are of `drsim.race.solids.SHAPES`."""

    world: str
    reverse: bool
    race_type: str
    model: str
    checkpoint: str
    racer: str
    color: str
    shapes: list[str] = field(default_factory=list)
    episodes: list[RecordedObjects] = field(default_factory=list)
    other_color: str = ""
    off_track_penalty_s: float | None = None
    collision_penalty_s: float | None = None
