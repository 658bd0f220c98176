"""What a trace does not tell about an evaluation, so that it can be filmed later."""

from dataclasses import dataclass, field

from drcli.base.json_record import JsonRecord


@dataclass(frozen=True)
class RecordedObjects(JsonRecord):
    """What stood and drove around the car in one episode of a trace.

    Attributes:
        episode: Number of the episode in the trace.
        poses: x and y in metres and yaw in radians of each object, for each row of the episode; a
            single row if nothing moved.
    """

    episode: int
    poses: list[list[list[float]]]


@dataclass(frozen=True)
class RaceRecording(JsonRecord):
    """The race of a trace. It lies beside the trace of an evaluation.

    Attributes:
        world: The track, as DR_WORLD_NAME names it.
        reverse: Whether it was driven against the direction of its name.
        race_type: As DR_RACE_TYPE.
        model: Prefix of the model, or the file, that drove.
        checkpoint: Name of its checkpoint; empty for a file.
        racer: As DR_RACER_NAME.
        color: As DR_CAR_COLOR.
        shapes: What the objects are, by the names of `drsim.race.solids.SHAPES`.
        episodes: Where they were; empty without objects.
        other_color: Of the other car in a race of two models; empty without one.
        off_track_penalty_s: As DR_EVAL_OFF_TRACK_PENALTY, simulated seconds; None if unknown.
        collision_penalty_s: As DR_EVAL_COLLISION_PENALTY, likewise.
    """

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
