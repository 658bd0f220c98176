"""Lists tracks; reads their files again only after changes.

Measuring loads compiled geometry, which takes two seconds.
"""

import json
from contextlib import suppress
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path

from drcli import __version__
from drcli.base.installation import lazy_imports
from drcli.tracks.track_facts import TrackFacts, TrackList

with lazy_imports():
    from drcli.tracks import tracks_folder

_MEASURED = 3
"""2: repeated rows count as waypoints."""


def list_tracks(folder: Path, memory: Path) -> TrackList:
    """Built-in and own tracks; the file `memory` keeps the list if it can be written."""
    state = _state(folder)
    with suppress(OSError, ValueError, TypeError, KeyError):  # missing or damaged
        known = json.loads(memory.read_bytes())
        if known["state"] == state:
            tracks = [TrackFacts(**facts) for facts in known["tracks"]]
            return TrackList(str(folder), tracks, known["unreadable"])

    found = tracks_folder.measure_tracks(folder)
    with suppress(OSError):  # a read-only folder
        memory.parent.mkdir(parents=True, exist_ok=True)
        memory.write_text(json.dumps({"state": state, **asdict(found)}), "utf-8")
    return found


def _state(folder: Path) -> list[list[str | int]]:
    spec = find_spec("drsim")
    packages = (spec.submodule_search_locations or ()) if spec is not None else ()
    folders = [folder, *(Path(package) / "track" / "definitions" for package in packages)]
    files = sorted(path for place in folders for path in place.glob("*"))
    state: list[list[str | int]] = [[__version__, _MEASURED]]
    for path in files:
        with suppress(OSError):  # removed meanwhile
            status = path.stat()
            state.append([str(path), status.st_size, status.st_mtime_ns])
    return state
