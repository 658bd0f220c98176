"""What a video holds."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class FilmedEpisode:
    """An episode in a video.

    Attributes:
        episode: Its number in the trace.
        seconds: Simulated seconds.
        progress: Percent of the lap.
        status: How it ended, such as "Lap complete".
        resets: How often the car left the track or crashed before its end.
        penalty_s: Penalties in the time, simulated seconds.
        clean: Whether the lap was completed without reset and penalty.
        text: How it ended, with its time if it was completed, for people.
    """

    episode: int
    seconds: float
    progress: float
    status: str
    resets: int
    penalty_s: float = 0.0
    clean: bool = False
    text: str = ""


@dataclass(frozen=True)
class VideoReport:
    """What `dr-video` made.

    Attributes:
        file: The video.
        seconds: How long it plays.
        frames: How many frames were made.
        width: Pixels.
        height: Pixels.
        fps: Frames per second.
        world: The track.
        trace: What was filmed.
        model: Prefix of the model that drove; empty if unknown.
        checkpoint: Of which the probabilities are; empty without any.
        renderer: What made the view.
        episodes: In the order of the film.
        notes: What a reader should know.
    """

    file: str
    seconds: float
    frames: int
    width: int
    height: int
    fps: int
    world: str
    trace: str
    model: str
    checkpoint: str
    renderer: str
    episodes: list[FilmedEpisode]
    notes: list[str] = field(default_factory=list)
