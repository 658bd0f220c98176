"""Which tracks there are, by name, without loading the simulation that drives on them."""

import re
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from drcli.findings import Finding, closest, shown

if TYPE_CHECKING:  # who presses Tab wants names of tracks only, and soon
    from drcli.settings.model import Settings

SAME_ROUTE = ("reinvent_carpet", "reinvent_concrete", "reinvent_wood")
"""Tracks of the simulation that have no file of their own: reinvent_base on other ground."""

ROUTE_FILES = (".npy", ".csv")


def built_in() -> list[str]:
    """Tracks that come with the simulation; none where it is not installed."""
    spec = find_spec("drsim")
    packages = (spec.submodule_search_locations or ()) if spec is not None else ()
    folders = [Path(package, "assets", "worlds") for package in packages]
    found = [name for folder in folders for name in _stems(folder, (".json",))]
    return sorted({*found, *SAME_ROUTE}) if found else []


def own(folder: Path) -> list[str]:
    """The racer's own tracks.

    Args:
        folder: Where their route files lie; it need not exist.
    """
    return _stems(folder, ROUTE_FILES)


def is_here(settings: "Settings") -> bool:
    """Whether the track of some settings is here; also where that cannot be known."""
    if not built_in():
        return True
    world = settings.world_name
    if world.endswith(ROUTE_FILES):
        if any(_is_file(place / world) for place in (settings.directory, settings.tracks_folder)):
            return True
        if "/" in world:
            return False
        world = Path(world).stem  # people write reinvent_base.npy and mean reinvent_base
    known = _known(settings)
    return world in known or re.sub(r"_c?cw\Z", "", world) in known


def missing(settings: "Settings") -> Iterator[Finding]:
    """The tracks of a training that are not here, each place that names one once."""
    places = set()
    for worker in range(len(settings.overrides) + 1):
        chosen = settings.for_worker(worker)
        place = chosen.source("DR_WORLD_NAME")
        if place in places or is_here(chosen):
            continue
        places.add(place)
        likely = closest(chosen.world_name, _known(settings))
        hint = f"Did you mean {likely}? " if likely is not None else ""
        yield Finding(
            place,
            f"DR_WORLD_NAME={shown(chosen.world_name)} is no track that is here",
            f"{hint}`dr-tracks list` shows all, `dr-tracks fetch` and `dr-tracks add` bring more.",
        )


def _is_file(path: Path) -> bool:
    """Whether a file has this path; none can have one of 10,000 letters or with a NUL in it."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _known(settings: "Settings") -> list[str]:
    return [*built_in(), *own(settings.tracks_folder)]


def _stems(folder: Path, endings: tuple[str, ...]) -> list[str]:
    try:
        names = [path.name for path in folder.iterdir()]
    except OSError:
        return []
    return sorted({Path(name).stem for name in names if name.endswith(endings)})
