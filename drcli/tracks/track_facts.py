"""What `dr tracks` shows."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TrackFacts:
    """The facts about a track.

    Attributes:
        name: Its name.
        length_m: Length of the centre line.
        width_m: Mean width.
        least_width_m: At the narrowest point.
        greatest_width_m: At the widest point.
        closed: Whether it is a loop.
        direction: "clockwise", "counterclockwise" or "open".
        waypoints: How many.
        repeated: Numbers of those that repeat the one before, as in many community routes.
        spacing_m: Mean distance between the others.
        line_family: "in" if the white line belongs to the road, else "out".
        source: "own" for a built-in track, else its file.
        difficulty: "easy", "medium" or "hard"; None if unknown.
        about: A line about it.
    """

    name: str
    length_m: float
    width_m: float
    least_width_m: float
    greatest_width_m: float
    closed: bool
    direction: str
    waypoints: int
    repeated: list[int]
    spacing_m: float
    line_family: str
    source: str
    difficulty: str | None
    about: str


@dataclass(frozen=True)
class TrackList:
    """All tracks that can be named.

    Attributes:
        folder: The racer's folder of tracks.
        tracks: By name.
        unreadable: Sentences about files that are not tracks.
    """

    folder: str
    tracks: list[TrackFacts]
    unreadable: list[str]
