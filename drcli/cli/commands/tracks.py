"""`dr tracks`."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import SettingsError, shown
from drcli.base.files import refuse_replacing
from drcli.base.installation import lazy_imports
from drcli.cli import completion, terminal
from drcli.cli.options import Replace
from drcli.cli.show import show as present
from drcli.cli.working_folder import settings, working_folder
from drcli.config.value_types import CarName
from drcli.tracks.track_facts import TrackList
from drcli.tracks.track_list import list_tracks

if TYPE_CHECKING:
    from drcli.drive.racer_limit import Asked, FastestLine

with lazy_imports():
    from drcli.config import track_names
    from drcli.drive import racer_limit
    from drcli.tracks import community, tracks_folder


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
def list_all(
    everything: Annotated[
        bool, typer.Option("--all", help="Also those of the community that can be fetched.")
    ] = False,
) -> None:
    """List all tracks: the built-in ones and those in the folder DR_TRACKS_DIR.

    The generated circuits, zoo-0 to zoo-9999999, are only mentioned.

    Example: dr-tracks list --json
    """
    memory = working_folder() / "data" / "cache" / "tracks.json"
    found = list_tracks(settings().tracks_folder, memory)
    for sentence in found.unreadable:
        terminal.warn(sentence)
    if everything:
        here = {track.name for track in found.tracks}
        known = [replace(each, installed=each.name in here) for each in _community()]
        found = replace(found, community=known)
    present(found)


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
    wanted = settings().race
    name = _meant(name, wanted.tracks_folder)
    wanted = wanted.replaced(world_name=name)
    if not name.endswith(track_names.ROUTE_FILES) and not track_names.is_installed(wanted):
        raise SettingsError(
            f"There is no track {shown(name)} here.", remedy=track_names.remedy(wanted)
        )
    columns = (
        tracks_folder.MAP_COLUMNS
        if terminal.as_json
        else min(tracks_folder.MAP_COLUMNS, terminal.columns())
    )
    known = _known_line(name)
    view = tracks_folder.show_track(
        name, wanted.tracks_folder, png, columns=columns, line=known.line if known else None
    )
    view = replace(view, limit=known.text if known else "")
    present(view)


@app.command()
def line(name: _Name, reverse: _Reverse = False, car: _Car = None) -> None:
    """Print the fastest line of the car on a track, as a list for a reward function.

    Each row has x and y in metres and the speed there in m/s.

    Example: dr-tracks line reinvent_base > line.py
    """
    present(racer_limit.fastest_line_of(_asked(name, car, reverse=reverse)), points=True)


@app.command()
def limit(name: _Name, reverse: _Reverse = False, car: _Car = None) -> None:
    """Show the fastest lap of the car on a track; compute it where it is not known.

    Computing takes a few seconds, and a minute or two in which the simulated car drives the line.
    It needs the packages of the extra `limit`.

    Example: dr-tracks limit my_track
    """
    present(racer_limit.computed_line_of(_asked(name, car, reverse=reverse)), points=False)


def _asked(name: str, car: CarName | None, *, reverse: bool) -> "Asked":
    loaded = settings()
    name = _meant(name, loaded.tracks_folder)
    car = car or loaded.sim_car
    return racer_limit.Asked(name, loaded.tracks_folder, loaded.directory, reverse, car)


def _meant(name: str, folder: Path) -> str:
    meant = track_names.meant(name, folder)
    if meant != name:
        terminal.say(f"{shown(name)} is the track {meant}.")
    return meant


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
    present(facts)


@app.command()
def generate(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the new track.")],
    length: Annotated[
        float | None, typer.Option("--length", help="Metres of a lap; drawn if left out.")
    ] = None,
    width: Annotated[
        float | None, typer.Option("--width", help="Metres of road; drawn if left out.")
    ] = None,
    tightest_turn: Annotated[
        float | None,
        typer.Option("--tightest-turn", help="Least radius of the centre line, in metres."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Another number, another track.")] = 0,
    force: _Force = False,
) -> None:
    """Draw a random circuit and put it into the folder DR_TRACKS_DIR.

    The tracks zoo-0, zoo-1 and so on are such circuits, there without this command.

    Example: dr-tracks generate tight --length 25 --width 0.8 --tightest-turn 0.6
    """
    facts = tracks_folder.generate_track(
        name,
        settings().tracks_folder,
        length_m=length,
        width_m=width,
        turn_m=tightest_turn,
        seed=seed,
        replace=force,
    )
    _warn_if_built_in(facts.name)
    present(facts)


@app.command()
def fetch(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="Name of a world, such as Oval_track.",
            autocompletion=completion.community_tracks,
        ),
    ] = None,
    url: Annotated[
        str | None, typer.Option("--from", help="Folder on the web; DR_TRACKS_URL if left out.")
    ] = None,
    called: Annotated[str | None, typer.Option("--name", help="Its name here.")] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All of the community that are not there yet.")
    ] = False,
    force: _Force = False,
) -> None:
    """Download a community track into the folder DR_TRACKS_DIR.

    Example: dr-tracks fetch Oval_track
    """
    s = settings()
    if everything:
        if name is not None or called is not None:
            raise typer.BadParameter("--all fetches every track; leave NAME and --name out.")
        present(_fetch_all(url or s.tracks_url, s.tracks_folder, again=force))
        return
    if name is None:
        raise typer.BadParameter("Name a track, or add --all. `dr-tracks list --all` shows them.")
    if url is None:
        name = _meant(name, s.tracks_folder)
    facts = community.fetch_track(
        name, url or s.tracks_url, s.tracks_folder, called=called, replace=force
    )
    _warn_if_built_in(facts.name)
    present(facts)


def _fetch_all(url: str, folder: Path, *, again: bool) -> TrackList:
    there = set() if again else {*track_names.own(folder), *track_names.built_in()}
    names = [each.name for each in _community() if each.name not in there]
    fetched = []
    for number, name in enumerate(names, start=1):
        terminal.say(f"{number} of {len(names)}: {name}")
        fetched.append(community.fetch_track(name, url, folder, replace=again))
    return TrackList(str(folder), fetched, [])


def _community() -> "list[track_names.CommunityTrack]":
    return sorted(track_names.community().values(), key=lambda each: each.name.casefold())


def _warn_if_built_in(name: str) -> None:
    if name in track_names.built_in() or track_names.ZOO.fullmatch(name):
        terminal.warn(
            f"{name} is also a built-in track. From now on, the name means your file; remove the "
            "file to get the built-in track back."
        )
