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
        penalty_s: In the time, simulated seconds.
        clean: Completed without reset and penalty.
        text: End, and time of a completed lap, for people.
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
        frames: How many.
        width: Pixels.
        height: Pixels.
        fps: Frames per second.
        world: The track.
        trace: What was filmed.
        model: Prefix of the model that drove, or empty.
        checkpoint: Whose probabilities are shown, or empty.
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
