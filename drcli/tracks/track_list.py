"""Lists the tracks without reading them again, as long as their files are the ones last listed.

To measure a track takes the simulation's compiled geometry, two seconds to load; who lists tracks
wants to see names.
"""

import json
from contextlib import suppress
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path

from drcli import __version__
from drcli.tracks.track_facts import TrackFacts, TrackList

_MEASURED = 2
"""Counts up when the same files are measured otherwise; 2: repeated rows count as waypoints."""


def list_tracks(folder: Path, memory: Path) -> TrackList:
    """All tracks that are built in or lie in the folder.

    Args:
        folder: Where tracks of the racer's own lie; it need not exist.
        memory: File in which the last list is kept. Where it cannot be written, none is.
    """
    state = _state(folder)
    with suppress(OSError, ValueError, TypeError, KeyError):  # none yet, or not ours
        known = json.loads(memory.read_bytes())
        if known["state"] == state:
            tracks = [TrackFacts(**facts) for facts in known["tracks"]]
            return TrackList(str(folder), tracks, known["unreadable"])
    from drcli.tracks.tracks_folder import measure_tracks

    found = measure_tracks(folder)
    with suppress(OSError):  # a folder that may only be read
        memory.parent.mkdir(parents=True, exist_ok=True)
        kept = {
            "state": state,
            "tracks": [asdict(facts) for facts in found.tracks],
            "unreadable": found.unreadable,
        }
        memory.write_text(json.dumps(kept), "utf-8")
    return found


def _state(folder: Path) -> list[list[str | int]]:
    """Names, sizes and times of all files that define tracks, our version, and how it measures."""
    spec = find_spec("drsim")
    packages = (spec.submodule_search_locations or ()) if spec is not None else ()
    folders = [folder, *(Path(package) / "track" / "definitions" for package in packages)]
    files = sorted(path for place in folders for path in place.glob("*"))
    state: list[list[str | int]] = [[__version__, _MEASURED]]
    for path in files:
        with suppress(OSError):  # gone again
            status = path.stat()
            state.append([str(path), status.st_size, status.st_mtime_ns])
    return state
