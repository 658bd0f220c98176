"""What `dr tracks` shows."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from drcli.base.report import BLANK, Col, View, bold, table
from drcli.config.track_names import COMMUNITY, CommunityTrack

_REPEATS = 3
LEAST_GAP_M = 0.01


@dataclass(frozen=True)
class TrackFacts:
    """The facts about a track."""

    name: Annotated[str, "Its name.", Col("track")]
    length_m: Annotated[float, "Length of the centre line.", Col("length", "{:.1f} m")]
    width_m: Annotated[float, "Mean width.", Col("width", "{:.2f} m")]
    least_width_m: Annotated[float, "At the narrowest point."]
    greatest_width_m: Annotated[float, "At the widest point."]
    closed: Annotated[bool, "Whether it is a loop."]
    direction: Annotated[str, '"clockwise", "counterclockwise" or "open".', Col("direction")]
    waypoints: Annotated[int, "How many."]
    repeated: Annotated[
        list[int], "Numbers of those that repeat the one before, as in many community routes."
    ]
    spacing_m: Annotated[float, "Mean distance between the others."]
    line_family: Annotated[str, '"in" if the white line belongs to the road, else "out".']
    source: Annotated[
        str,
        '"own" for a built-in track, else its file.',
        Col("from", of=lambda track: track.made_of(), side="left"),
    ]
    difficulty: Annotated[str | None, '"easy", "medium" or "hard"; None if unknown.']
    about: Annotated[str, "A line about it."]
    joined_m: Annotated[
        float, "Gap between the ends of the file that was closed to make a loop."
    ] = 0.0

    def made_of(self) -> str:
        return self.origin() if self.source == "own" else f"{Path(self.source).suffix} file"

    def origin(self) -> str:
        if self.source != "own":
            return self.source
        return f"built in, {self.difficulty}" if self.difficulty else "built in"

    def view(self) -> View:
        road = "is part of the road" if self.line_family == "in" else "is outside the road"
        width = f"{self.least_width_m:.2f} to {self.greatest_width_m:.2f} m"
        if self.greatest_width_m - self.least_width_m < 0.02:
            width = f"{self.width_m:.2f} m"
        repeats = "".join(f"; {number} repeats {number - 1}" for number in self.repeated[:_REPEATS])
        more = len(self.repeated) - _REPEATS
        return [
            bold(f"{self.name}: {self.about}" if self.about else self.name),
            f"{self.length_m:.2f} m long, {width} wide, {self.direction}; "
            f"{self.waypoints} waypoints, {self.spacing_m:.2f} m apart"
            f"{repeats}{f' and {more} more' if more > 0 else ''}",
            f"the white line {road}; {self.origin()}",
            self.joined_m >= LEAST_GAP_M
            and f"Its ends were {self.joined_m:.2f} m apart, less than the road is wide, and are "
            "joined to a loop.",
        ]


@dataclass(frozen=True)
class TrackList:
    """All tracks that can be named."""

    folder: Annotated[str, "The racer's folder of tracks."]
    tracks: Annotated[list[TrackFacts], "By name."]
    unreadable: Annotated[list[str], "Sentences about files that are not tracks."]
    community: Annotated[
        list[CommunityTrack], "With --all: the tracks that `dr-tracks fetch` brings."
    ] = field(default_factory=list)

    def view(self) -> View:
        own, here = Path(self.folder), Path.cwd()
        place = own.relative_to(here) if own.is_relative_to(here) else own
        return [
            table(self.tracks),
            f"{len(self.tracks)} tracks; your own are in {place}/.",
            "And generated circuits: zoo-0, zoo-1 and so on, to zoo-9999999.",
            BLANK if self.community else "",
            self.community and table(self.community),
            f"{len(self.community)} tracks of the community; `dr-tracks fetch NAME` brings one."
            if self.community
            else f"`dr-tracks list --all` also shows the {len(COMMUNITY)} of the community.",
        ]
