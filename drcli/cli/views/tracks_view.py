"""Shows tracks."""

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows

if TYPE_CHECKING:
    from drcli.tracks.track_facts import TrackFacts, TrackList
    from drcli.tracks.tracks_folder import TrackView
    from drcli.workers.racer_limit import FastestLine

_REPEATS = 3


def track_list(found: "TrackList") -> RenderableType:
    table = Rows(
        ("track", "length", "width", "direction", "from"),
        [
            (
                track.name,
                f"{track.length_m:.1f} m",
                f"{track.width_m:.2f} m",
                track.direction,
                f"{Path(track.source).suffix} file" if track.source != "own" else _origin(track),
            )
            for track in found.tracks
        ],
        left=("track", "direction", "from"),
    )
    own, here = Path(found.folder), Path.cwd()
    place = own.relative_to(here) if own.is_relative_to(here) else own
    return Group(table, Text(f"{len(found.tracks)} tracks; your own are in {place}/."))


def track(view: "TrackView") -> RenderableType:
    parts: list[RenderableType] = [Text(line) for line in view.map_lines]
    parts.append(track_facts(view.facts))
    if view.limit:
        parts.append(Text(view.limit))
    if view.picture:
        parts.append(Text(f"Picture: {view.picture}"))
    return Group(*parts)


def line(found: "FastestLine") -> RenderableType:
    rows = (f"    ({x:.3f}, {y:.3f}, {speed:.2f})," for x, y, speed in found.line)
    return Text("\n".join([f"# {found.text}", "FASTEST_LINE = [", *rows, "]"]))


def track_facts(facts: "TrackFacts") -> RenderableType:
    line = "is part of the road" if facts.line_family == "in" else "is outside the road"
    width = (
        f"{facts.width_m:.2f} m"
        if facts.greatest_width_m - facts.least_width_m < 0.02
        else f"{facts.least_width_m:.2f} to {facts.greatest_width_m:.2f} m"
    )
    repeats = "".join(f"; {number} repeats {number - 1}" for number in facts.repeated[:_REPEATS])
    more = len(facts.repeated) - _REPEATS
    return Group(
        Text(f"{facts.name}: {facts.about}" if facts.about else facts.name, style="bold"),
        Text(
            f"{facts.length_m:.2f} m long, {width} wide, {facts.direction}; "
            f"{facts.waypoints} waypoints, {facts.spacing_m:.2f} m apart"
            f"{repeats}{f' and {more} more' if more > 0 else ''}"
        ),
        Text(f"the white line {line}; {_origin(facts)}"),
    )


def _origin(facts: "TrackFacts") -> str:
    if facts.source != "own":
        return facts.source
    return f"built in, {facts.difficulty}" if facts.difficulty else "built in"
