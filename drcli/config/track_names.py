"""The names of all tracks, without loading the simulation."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from drcli.base.errors import Place, Problem, Severity, closest, shown
from drcli.base.files import is_left_behind
from drcli.base.report import Col
from drcli.config.fields import setting_problem
from drcli.config.run_config import DriveConfig

ROUTE_FILES = (".npy", ".csv")

ASKED = "answer yes when a start asks on a terminal"


@dataclass(frozen=True)
class CommunityTrack:
    """A world of the reference simulator, version 6."""

    name: Annotated[str, "Its name, for DR_WORLD_NAME.", Col("track")]
    length_m: Annotated[float, "Length of the centre line.", Col("length", "{:.1f} m")]
    width_m: Annotated[float, "Mean width.", Col("width", "{:.2f} m")]
    way: Annotated[str, "cw, ccw or open.", Col("way")]
    console_name: Annotated[str, "Its name in consoles; empty if it has none.", Col("also called")]
    installed: Annotated[
        bool, "Whether it can be driven now.", Col("here", lambda here: "yes" if here else "")
    ] = False


@cache
def community() -> dict[str, CommunityTrack]:
    """By name."""
    lines = Path(__file__).with_name("community_tracks.csv").read_text("utf-8").splitlines()[1:]
    fields = (line.split(";") for line in lines)
    return {
        name: CommunityTrack(name, float(length), float(width), way, called)
        for name, length, width, way, called in fields
    }


COMMUNITY = frozenset(community())

ZOO = re.compile(r"zoo-(?:0|[1-9][0-9]{0,6})")
"""Generated circuits, as `drsim.track.zoo` reads them."""

MOST_CIRCUITS = 1_000
_CIRCUITS = re.compile(r"zoo:([0-9]{1,7})(?:-([0-9]{1,7}))?")
_SET = "zoo:24 means zoo-0 to zoo-23, zoo:100-123 means zoo-100 to zoo-123"


def built_in() -> list[str]:
    """None where the simulation is not installed."""
    spec = find_spec("drsim")
    packages = (spec.submodule_search_locations or ()) if spec is not None else ()
    folders = [Path(package, "track", "definitions") for package in packages]
    return sorted(name for folder in folders for name in _stems(folder, (".json",)))


def definition(world: str) -> Path | None:
    """The file of a built-in track, or whose route it shares."""
    spec = find_spec("drsim")
    packages = (spec.submodule_search_locations or ()) if spec is not None else ()
    for package in packages:
        file = Path(package, "track", "definitions", f"{world}.json")
        if _is_file(file):
            shared = json.loads(file.read_text("utf-8")).get("same_route_as")
            return file if shared is None else file.with_name(f"{shared}.json")
    return None


def own(folder: Path) -> list[str]:
    return _stems(folder, ROUTE_FILES)


def is_installed(race: DriveConfig) -> bool:
    """True if that cannot be known."""
    if not built_in():
        return True
    world = race.world_name
    if world.endswith(ROUTE_FILES):
        if any(_is_file(place / world) for place in (race.directory, race.tracks_folder)):
            return True
        if "/" in world:
            return False
        world = Path(world).stem  # racers write reinvent_base.npy for reinvent_base
    names = {world, _both_ways(world)}
    return any(map(ZOO.fullmatch, names)) or not names.isdisjoint(_known(race))


def own_route_file(race: DriveConfig) -> Path | None:
    """Of a track that is not built in."""
    name = _name(race)
    plain = _both_ways(name)
    if {name, plain} & set(built_in()):
        return None
    names = [name] if name.endswith(ROUTE_FILES) else [f"{name}{end}" for end in ROUTE_FILES]
    names += [f"{plain}{end}" for end in ROUTE_FILES]
    places = [folder / each for folder in (race.tracks_folder, race.directory) for each in names]
    return next((path for path in places if _is_file(path)), None)


def track_problem(
    race: DriveConfig,
    *,
    known_suffices: bool = False,
    listed_in: tuple[str, Place] | None = None,
) -> Problem | None:
    """The problem with the track of a race, if any.

    A community track that is not installed is one unless the start fetches it without a question,
    or `known_suffices`: nothing is to start yet. `listed_in` is the setting whose list names it,
    with its place.
    """
    if is_installed(race):
        return None
    name = race.world_name
    setting, place = listed_in or ("DR_WORLD_NAME", race.place("DR_WORLD_NAME"))
    start = f"{setting}: " if listed_in else f"{setting}="
    if _name(race) in COMMUNITY:
        what = f"{start}{name} is a community track that is not installed yet."
        fetched = known_suffices or race.tracks_fetch == "always"
        severity: Severity = "note" if fetched else "error"
        return setting_problem(setting, place, what, remedy(race), severity=severity)
    what = f"{start}{shown(name)} is not a known track."
    return setting_problem(setting, place, what, remedy(race))


def track_problems(races: Sequence[DriveConfig], *, known_suffices: bool = False) -> list[Problem]:
    problems = [track_problem(race, known_suffices=known_suffices) for race in races]
    problems += list_problems(races, known_suffices=known_suffices)
    return list(dict.fromkeys(problem for problem in problems if problem is not None))


def expand_worlds(text: str, tracks_folder: Path) -> tuple[str, ...]:
    """The tracks that a list names, each once; `worlds_problems` tells what is wrong with it.

    Words stand between commas or blanks: a name, a pattern of installed tracks such as `Bowtie*`
    in any case, or `zoo:24` for the generated circuits zoo-0 to zoo-23, `zoo:100-123` for those.
    """
    installed = sorted({*built_in(), *own(tracks_folder)})
    return tuple(
        dict.fromkeys(name for word in _words(text) for name in _named_by(word, installed))
    )


def worlds_problems(
    setting: str, place: Place, text: str, race: DriveConfig, *, known_suffices: bool = False
) -> list[Problem]:
    """What is wrong with the list of tracks in a setting; see `track_problem`."""
    listed_in, installed = (setting, place), _known(race)
    problems: list[Problem | None] = []
    for word in _words(text):
        if word.startswith("zoo:"):
            circuits = _named_by(word, ())
            if not circuits or len(circuits) > MOST_CIRCUITS:
                what = f"{setting}: {shown(word)} does not name 1 to {MOST_CIRCUITS:,} circuits."
                problems.append(setting_problem(setting, place, what, f"Correct it: {_SET}."))
        elif not _is_pattern(word):
            each = race.replaced(world_name=word)
            problems.append(track_problem(each, known_suffices=known_suffices, listed_in=listed_in))
        elif built_in() and not _named_by(word, installed):
            what = f"{setting}: no installed track fits {shown(word)}."
            known = _named_by(word, sorted(COMMUNITY))
            how = f"`dr-tracks fetch {known[0]}` brings one. " if known else ""
            how += "`dr-tracks list --all` shows all; correct the pattern or leave it out."
            problems.append(setting_problem(setting, place, what, how))
    return list(dict.fromkeys(problem for problem in problems if problem is not None))


WORLD_LISTS = ("DR_TRAIN_WORLDS", "DR_TRAIN_EVAL_WORLD")


def world_list(race: DriveConfig, setting: str) -> str:
    text: str = getattr(race, race.declared[setting].field)
    return text


def races_on(race: DriveConfig, setting: str) -> list[DriveConfig]:
    """The race on each track that one of the WORLD_LISTS names."""
    source = {"DR_WORLD_NAME": race.place(setting)}
    return [
        race.replaced(world_name=world, sources={**race.sources, **source})
        for world in expand_worlds(world_list(race, setting), race.tracks_folder)
    ]


def training_races(race: DriveConfig) -> list[DriveConfig]:
    """The race on DR_WORLD_NAME, then on the further tracks of its training."""
    further = races_on(race, "DR_TRAIN_WORLDS")
    return [race, *(each for each in further if each.world_name != race.world_name)]


def races_with_lists(races: Sequence[DriveConfig]) -> list[DriveConfig]:
    """With those on the tracks of their lists."""
    lists = [each for race in races for name in WORLD_LISTS for each in races_on(race, name)]
    return [*races, *lists]


def list_problems(races: Sequence[DriveConfig], *, known_suffices: bool = False) -> list[Problem]:
    """What is wrong with the lists of tracks of a training."""
    problems = []
    by_tracks = {
        (race.world_name, *(world_list(race, name) for name in WORLD_LISTS)): race for race in races
    }
    for race in by_tracks.values():
        for name in WORLD_LISTS:
            text, place = world_list(race, name), race.place(name)
            problems += worlds_problems(name, place, text, race, known_suffices=known_suffices)
        trained = {each.world_name for each in training_races(race)}
        both = [each.world_name for each in races_on(race, name) if each.world_name in trained]
        if both:
            what = (
                f"{name}: {both[0]} is trained too, so its laps are not those of an unseen track."
            )
            remedy = "Leave it out of DR_TRAIN_EVAL_WORLD or of the tracks of the training."
            problems.append(setting_problem(name, place, what, remedy, severity="warning"))
    return list(dict.fromkeys(problems))


def to_fetch(races: Sequence[DriveConfig]) -> list[str]:
    missing = [race for race in races if _name(race) in COMMUNITY and not is_installed(race)]
    return list(dict.fromkeys(map(_name, missing)))


def remedy(race: DriveConfig) -> str:
    name = _name(race)
    if name in COMMUNITY:
        add = f"Without a network add its file with `dr-tracks add {name}.npy`."
        if race.tracks_fetch == "always":
            return f"The next start fetches it (DR_TRACKS_FETCH=always). {add}"
        asked = f", {ASKED}" if race.tracks_fetch == "ask" else ""
        return (
            f"Fetch it with `dr-tracks fetch {name}`{asked}, or let a start fetch it with "
            f"DR_TRACKS_FETCH=always. {add}"
        )
    called = track_called(race.world_name)
    if called is not None:
        return f"Write {called}, which consoles call {community()[called].console_name}."
    return hint(race.world_name, race.tracks_folder) + (
        "`dr-tracks list --all` shows all, `dr-tracks fetch` and `dr-tracks add` bring more."
    )


def track_called(name: str) -> str | None:
    """The one track of the community that consoles call so, wholly or in part.

    Both directions of a route are one track: the name means that without a direction.
    """
    named = _called(name)
    routes = {_both_ways(each) for each in named}
    return next(iter(routes & set(named)), None) if len(routes) == 1 else _only(named)


def meant(name: str, tracks_folder: Path) -> str:
    """A name as it was typed, or that of the track that consoles call so."""
    return name if _is_known(name, tracks_folder) else track_called(name) or name


def hint(name: str, tracks_folder: Path) -> str:
    """A question with the track that is probably meant, and a space after it; may be empty."""
    spoken = {
        part: track
        for each in community().values()
        for part in (each.console_name, *each.console_name.split())
        if (track := track_called(part))
    }
    word = closest(name.replace("_", " "), spoken, cutoff=0.75)
    likely = (
        next(iter(_called(name)), None)
        or closest(name, [*built_in(), *own(tracks_folder), *COMMUNITY])
        or (word and spoken[word])
    )
    return f"Did you mean {likely}? " if likely else ""


def unknown_track(name: str, tracks_folder: Path) -> str | None:
    """A sentence about a name that is neither installed nor of the community; else None."""
    if _is_known(name, tracks_folder):
        return None
    return f"{shown(name)} is not a known track. {hint(name, tracks_folder)}".strip()


def _called(name: str) -> list[str]:
    words = name.replace("_", " ").casefold()
    spoken = {each.name: each.console_name.casefold() for each in community().values()}
    return [each for each in spoken if spoken[each] == words] or [
        each for each in spoken if len(words) > 3 and words in spoken[each]
    ]


def _is_known(name: str, tracks_folder: Path) -> bool:
    known = {*built_in(), *own(tracks_folder), *COMMUNITY}
    plain = _both_ways(name)
    return bool({name, plain} & known or ZOO.fullmatch(plain)) or name.endswith(ROUTE_FILES)


def _both_ways(name: str) -> str:
    return re.sub(r"_c?cw\Z", "", name)


def _only(names: list[str]) -> str | None:
    return names[0] if len(names) == 1 else None


def _words(text: str) -> list[str]:
    return text.replace(",", " ").split()


def _is_pattern(word: str) -> bool:
    return not {"*", "?", "["}.isdisjoint(word)


def _named_by(word: str, names: Sequence[str]) -> Sequence[str]:
    """None for a wrong set of circuits; one too many is enough to refuse a set."""
    if word.startswith("zoo:"):
        numbers = _CIRCUITS.fullmatch(word)
        if numbers is None:
            return ()
        first, last = (int(number or 0) for number in numbers.groups())
        circuits = range(first) if numbers.group(2) is None else range(first, last + 1)
        return [f"zoo-{number}" for number in circuits[: MOST_CIRCUITS + 1]]
    if not _is_pattern(word):
        return (word,)
    return [name for name in names if fnmatchcase(name.casefold(), word.casefold())]


def _name(race: DriveConfig) -> str:
    world = race.world_name
    return Path(world).stem if world.endswith(ROUTE_FILES) and "/" not in world else world


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _known(race: DriveConfig) -> list[str]:
    return [*built_in(), *own(race.tracks_folder)]


def _stems(folder: Path, endings: tuple[str, ...]) -> list[str]:
    try:
        names = [path.name for path in folder.iterdir()]
    except OSError:
        return []
    found = (name for name in names if name.endswith(endings) and not is_left_behind(name))
    return sorted({Path(name).stem for name in found})
