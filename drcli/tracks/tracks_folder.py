"""Measures, shows and adds tracks."""

import contextlib
import dataclasses
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from drcli.base.errors import SettingsError
from drcli.base.files import hand_out, make_folder, rewrite
from drcli.base.report import BLANK, View
from drcli.tracks.track_facts import TrackFacts, TrackList
from drsim.errors import TrackError
from drsim.track import zoo
from drsim.track.route_files import read_route, write_route
from drsim.track.track import Track
from drsim.track.worlds import WorldInfo, describe, known_worlds, load_track
from drsim.viewing.track_map import picture_map, png_bytes, text_map

MAP_COLUMNS = 78
_OPTIONS = {"width_m": "--width", "length_m": "--length", "turn_m": "--tightest-turn"}
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,99}")


@dataclass(frozen=True)
class TrackView:
    """A track and its map."""

    facts: Annotated[TrackFacts, "About the track."]
    map_lines: Annotated[list[str], "A map in letters for a terminal, top line first."]
    picture: Annotated[str | None, "Its file, if requested."]
    limit: Annotated[str, "A sentence about the fastest lap of the car, or empty."] = ""

    def view(self) -> View:
        picture = self.picture and f"Picture: {self.picture}"
        return [
            *(line or BLANK for line in self.map_lines),
            *self.facts.view(),
            self.limit,
            picture,
        ]


def measure_tracks(folder: Path) -> TrackList:
    tracks, unreadable = [], []
    for name in known_worlds(folder):
        try:
            tracks.append(_facts(describe(name, folder)))
        except TrackError as error:
            unreadable.append(str(error))
    return TrackList(str(folder), tracks, unreadable)


def show_track(
    name: str,
    folder: Path,
    picture: Path | None = None,
    *,
    columns: int = MAP_COLUMNS,
    line: Sequence[tuple[float, float, float]] | None = None,
) -> TrackView:
    """`line` is for the picture: x, y in metres and speed in m/s.

    Raises:
        SettingsError: No such track, or the picture cannot be written.
    """
    try:
        facts = _facts(describe(name, folder))
        track = load_track(name, folder)
    except TrackError as error:
        raise _refused(error) from None
    if picture is not None:
        drawn = None if line is None else np.array(line)
        rewrite(picture, png_bytes(picture_map(track, line=drawn)))
    return TrackView(facts, text_map(track, columns), str(picture) if picture else None)


def add_track(
    file: Path,
    folder: Path,
    *,
    name: str | None = None,
    width_m: float | None = None,
    length_m: float | None = None,
    replace: bool = False,
) -> TrackFacts:
    """Check a .npy, .csv or .svg file and put it into the folder.

    `width_m` is for centre lines; the lap is scaled to `length_m`.

    Raises:
        SettingsError: The file is not a track, or the name is taken.
    """
    wanted = name or file.stem
    target = target_of(wanted, folder, replace=replace)
    try:
        track = read_route(file, name=wanted, width_m=width_m, length_m=length_m)
    except TrackError as error:
        raise _refused(error, file, _OPTIONS) from None
    return _kept(track, target)


def generate_track(
    name: str,
    folder: Path,
    *,
    length_m: float | None = None,
    width_m: float | None = None,
    turn_m: float | None = None,
    seed: int = 0,
    replace: bool = False,
) -> TrackFacts:
    """Draw a circuit and put it into the folder.

    Raises:
        SettingsError: There is no such circuit, or the name is taken.
    """
    target = target_of(name, folder, replace=replace)
    try:
        track = zoo.generate(name, length_m=length_m, width_m=width_m, turn_m=turn_m, seed=seed)
    except TrackError as error:
        raise _refused(error, options=_OPTIONS) from None
    return _kept(track, target)


def _kept(track: Track, target: Path) -> TrackFacts:
    unfinished = target.with_name(f".{target.stem}.{os.getpid()}.npy")
    try:
        make_folder(target.parent)
        write_route(track, unfinished)
        hand_out(unfinished)
        unfinished.replace(target)
    except TrackError as error:
        raise _refused(error) from None
    except OSError as error:
        raise SettingsError(
            f"{target} cannot be written: {error.strerror}.",
            remedy="Make room on the disk, correct the permissions, or set DR_TRACKS_DIR to "
            "another folder.",
        ) from None
    finally:
        with contextlib.suppress(OSError):  # it only exists if something went wrong
            unfinished.unlink()
    facts = _facts(describe(str(target)))
    return dataclasses.replace(facts, joined_m=round(track.joined_m, 3))


def target_of(name: str, folder: Path, *, replace: bool) -> Path:
    """Raises SettingsError for a wrong or taken name."""
    if not _NAME.fullmatch(name):
        raise SettingsError(
            f"{name[:80]!r} is not a valid track name; use letters, digits, _ and -.",
            remedy="Choose another with --name.",
        )
    target = folder / f"{name}.npy"
    if target.exists() and not replace:
        raise SettingsError(
            f"The track {name} already exists: {target}.",
            remedy="Choose another name with --name, or replace it with --force.",
        )
    return target


def _facts(info: WorldInfo) -> TrackFacts:
    return TrackFacts(
        name=info.name if info.source == "own" else Path(info.name).stem,
        length_m=round(info.length_m, 3),
        width_m=round(info.width_m.mean, 3),
        least_width_m=round(info.width_m.least, 3),
        greatest_width_m=round(info.width_m.greatest, 3),
        closed=info.direction != "open",
        direction=info.direction,
        waypoints=info.waypoints,
        repeated=info.repeated,
        spacing_m=round(info.spacing_m, 3),
        line_family=info.line_family,
        source=info.source,
        difficulty=info.difficulty,
        about=info.about,
        joined_m=round(info.joined_m, 3),
    )


def _refused(
    error: TrackError, file: Path | None = None, options: dict[str, str] | None = None
) -> SettingsError:
    """The simulation's error, whose last sentence is the remedy.

    `options` maps its parameters to the command's.
    """
    text = str(error).strip()
    start = f"{file}: " if file is not None and text.startswith(f"{file}: ") else ""
    text = text.removeprefix(start)
    for parameter, option in (options or {}).items():
        text = re.sub(rf"\b{parameter}\b", option, text)
    text = start + text
    message, _, remedy = text.rpartition(". ")
    return SettingsError(f"{message}." if message else remedy, remedy=remedy if message else "")
