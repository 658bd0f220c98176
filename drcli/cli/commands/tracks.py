"""`dr tracks`."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.text import Text

from drcli.base.errors import SettingsError, shown
from drcli.base.files import refuse_replacing
from drcli.base.installation import lazy_imports
from drcli.cli import completion, console
from drcli.cli.options import Replace
from drcli.cli.views.layout import Rows
from drcli.cli.working_folder import settings, working_folder
from drcli.config.value_types import CarName
from drcli.tracks.track_list import list_tracks

if TYPE_CHECKING:
    from drcli.drive.racer_limit import Asked, FastestLine
    from drcli.tracks.track_facts import TrackFacts, TrackList
    from drcli.tracks.tracks_folder import TrackView

with lazy_imports():
    from drcli.config import track_names
    from drcli.drive import racer_limit
    from drcli.tracks import community, tracks_folder


# Shows tracks.


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
    parts: list[RenderableType] = [Text(show_line) for show_line in view.map_lines]
    parts.append(track_facts(view.facts))
    if view.limit:
        parts.append(Text(view.limit))
    if view.picture:
        parts.append(Text(f"Picture: {view.picture}"))
    return Group(*parts)


def show_line(found: "FastestLine") -> RenderableType:
    rows = (f"    ({x:.3f}, {y:.3f}, {speed:.2f})," for x, y, speed in found.line)
    return Text("\n".join([f"# {found.text}", "FASTEST_LINE = [", *rows, "]"]))


def track_facts(facts: "TrackFacts") -> RenderableType:
    show_line = "is part of the road" if facts.line_family == "in" else "is outside the road"
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
        Text(f"the white line {show_line}; {_origin(facts)}"),
    )


def _origin(facts: "TrackFacts") -> str:
    if facts.source != "own":
        return facts.source
    return f"built in, {facts.difficulty}" if facts.difficulty else "built in"


app = typer.Typer(
    no_args_is_help=True,
    help="List, show, add and fetch tracks.\n\nExample: dr-tracks show reinvent_base",
)

_Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME",
        help="Name of a track, or a route file.",
        autocompletion=completion.worlds,
    ),
]
_Reverse = Annotated[
    bool, typer.Option("--reverse", help="Drive against the direction of the track.")
]
_Car = Annotated[CarName | None, typer.Option("--car", help="The car; DR_SIM_CAR if left out.")]
_Force = Annotated[bool, typer.Option("-f", "--force", help="Replace a track of the same name.")]


@app.command("list")
def list_all() -> None:
    """List all tracks: the built-in ones and those in the folder DR_TRACKS_DIR.

    Example: dr-tracks list --json
    """
    memory = working_folder() / "data" / "cache" / "tracks.json"
    found = list_tracks(settings().tracks_folder, memory)
    for sentence in found.unreadable:
        console.warn(sentence)
    console.emit(found, track_list(found))


@app.command()
def show(
    name: _Name,
    png: Annotated[Path | None, typer.Option("--png", help="Also write a picture.")] = None,
    force: Replace = False,
) -> None:
    """Show a track: facts and a small map.

    Example: dr-tracks show reinvent_base --png map.png
    """
    if png is not None:
        refuse_replacing(png, force=force)
    wanted = settings().race.replaced(world_name=name)
    if not name.endswith(track_names.ROUTE_FILES) and not track_names.is_installed(wanted):
        raise SettingsError(
            f"There is no track {shown(name)} here.", remedy=track_names.remedy(wanted)
        )
    columns = (
        tracks_folder.MAP_COLUMNS
        if console.as_json
        else min(tracks_folder.MAP_COLUMNS, console.columns())
    )
    known = _known_line(name)
    view = tracks_folder.show_track(
        name, wanted.tracks_folder, png, columns=columns, line=known.line if known else None
    )
    view = replace(view, limit=known.text if known else "")
    console.emit(view, track(view))


@app.command()
def line(name: _Name, reverse: _Reverse = False, car: _Car = None) -> None:
    """Print the fastest line of the car on a track, as a list for a reward function.

    Each row has x and y in metres and the speed there in m/s.

    Example: dr-tracks line reinvent_base > line.py
    """
    found = racer_limit.fastest_line_of(_asked(name, car, reverse=reverse))
    console.emit(found, show_line(found))


@app.command()
def limit(name: _Name, reverse: _Reverse = False, car: _Car = None) -> None:
    """Show the fastest lap of the car on a track; compute it where it is not known.

    Computing takes a few seconds, and a minute or two in which the simulated car drives the line.
    It needs the packages of the extra `limit`.

    Example: dr-tracks limit my_track
    """
    found = racer_limit.computed_line_of(_asked(name, car, reverse=reverse))
    console.emit(found, Text(found.text))


def _asked(name: str, car: CarName | None, *, reverse: bool) -> "Asked":
    loaded = settings()
    car = car or loaded.sim_car
    return racer_limit.Asked(name, loaded.tracks_folder, loaded.directory, reverse, car)


def _known_line(name: str) -> "FastestLine | None":
    with suppress(SettingsError):
        return racer_limit.fastest_line_of(_asked(name, None, reverse=False))
    return None


@app.command()
def add(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A .npy, .csv or .svg file.")],
    name: Annotated[str | None, typer.Option("--name", help="Name of the track.")] = None,
    width: Annotated[
        float | None, typer.Option("--width", help="Metres of road around a centre line.")
    ] = None,
    length: Annotated[
        float | None, typer.Option("--length", help="Metres of a lap; needed by .svg files.")
    ] = None,
    force: _Force = False,
) -> None:
    """Check a route and put it into the folder DR_TRACKS_DIR.

    Example: dr-tracks add my_track.svg --length 25 --width 0.9
    """
    folder = settings().tracks_folder
    facts = tracks_folder.add_track(
        file, folder, name=name, width_m=width, length_m=length, replace=force
    )
    _warn_if_built_in(facts.name)
    console.emit(facts, track_facts(facts))


@app.command()
def fetch(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Name of a world, such as Oval_track.")
    ],
    url: Annotated[
        str | None, typer.Option("--from", help="Folder on the web; DR_TRACKS_URL if left out.")
    ] = None,
    called: Annotated[str | None, typer.Option("--name", help="Its name here.")] = None,
    force: _Force = False,
) -> None:
    """Download a community track into the folder DR_TRACKS_DIR.

    Example: dr-tracks fetch Oval_track
    """
    s = settings()
    facts = community.fetch_track(
        name, url or s.tracks_url, s.tracks_folder, called=called, replace=force
    )
    _warn_if_built_in(facts.name)
    console.emit(facts, track_facts(facts))


def _warn_if_built_in(name: str) -> None:
    if name in track_names.built_in():
        console.warn(
            f"{name} is also a built-in track. From now on, the name means your file; remove the "
            "file to get the built-in track back."
        )
