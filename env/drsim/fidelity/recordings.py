"""Recorded drives: simtrace CSV files of the reference simulator, or ours.

Lines that cannot be read are counted, and the drive is cut there.
"""

import csv
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drsim.arrays import Floats, Ints

_NEEDED = ("X", "Y", "yaw", "tstamp")

_STANDING = ("prepare", "pause", "manual_pause", "park")
"""`episode_status` while the reference holds the car."""

_GOING_ON = (*_STANDING, "in_progress")
"""After others the car is put elsewhere, or the episode is over."""

_LONGEST_STEP_S = 0.5
"""A longer row is a break: the car drove on. A host that is too slow makes steps of 0.2 s."""

_FASTEST_MPS = 5.0
_JUMP_M = 0.15
"""A car that got this much further than by its speed was put there."""

_ACTION = re.compile(r'"?\[\s*([^\s,\]]+)[\s,]+([^\s,\]]+)\s*\]"?')
"""Degrees and m/s; as a list of Python, with a comma."""

_WHEELS_ON = {"true": 1, "1": 1, "false": 0, "0": 0}


class RecordingError(ValueError):
    """Recordings that are missing or cannot be used."""


@dataclass(frozen=True)
class Recording:
    """A stretch of an episode that was driven without a break.

    A row's pose is the one that its action starts from. Unknown columns are NaN or -1.

    Attributes:
        poses: x, y (metres, the point 0.14 m ahead of the car's origin) and yaw (radians, without
            jumps). Shape (t, 3).
        actions: Degrees and m/s. Shape (t, 2).
        starts_s: Simulation time. Shape (t,).
        held: The first row's action did not act.
        from_rest: The car stood at first; else, how it moved is unknown.
        progress: Percent. Shape (t,).
        wheels_on: 1 if all were on the track. Shape (t,).
    """

    episode: int
    poses: Floats
    actions: Floats
    starts_s: Floats
    ends_s: Floats
    held: bool
    from_rest: bool
    progress: Floats
    waypoint: Ints
    wheels_on: Ints
    track_length_m: float


@dataclass(frozen=True)
class Recordings:
    """Drives, and how many lines could not be read."""

    drives: list[Recording]
    left_out: int


def load_recordings(folder: Path) -> Recordings:
    """Read every simtrace file (`*-iteration.csv`) below a folder, or one file.

    Raises:
        RecordingError: Nothing can be read there.
    """
    drives: list[Recording] = []
    left_out = 0
    for file in _trace_files(folder):
        steps, lost = _read(file)
        drives += _drives(steps)
        left_out += lost
    if not drives:
        raise RecordingError(
            f"No simtrace in {folder} holds a row that can be read. Name the folder of a training "
            "or evaluation that drove."
        )
    return Recordings(drives, left_out)


def _trace_files(folder: Path) -> list[Path]:
    if folder.is_file():
        return [folder]
    if not folder.is_dir():
        raise RecordingError(f"The folder {folder} does not exist. Correct the path.")
    files = folder.rglob("[!.]*-iteration.csv")  # macOS leaves a `._` file beside each
    found = sorted(files, key=lambda file: (file.parent, len(file.name), file.name))
    if not found:
        raise RecordingError(
            f"{folder} holds no *-iteration.csv file, nor does a folder below it. Name the folder "
            "of a training-simtrace or an evaluation-simtrace."
        )
    return found


@dataclass(frozen=True)
class _Step:
    line: int
    episode: int
    count: float
    pose: tuple[float, float, float]
    action: tuple[float, float]
    end_s: float
    status: str
    progress: float
    waypoint: int
    wheels_on: int
    track_length_m: float


def _read(file: Path) -> tuple[list[_Step], int]:
    try:
        text = file.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise RecordingError(
            f"{file} cannot be read ({error.strerror}). Correct its permissions, or choose another "
            "folder."
        ) from None
    lines = text.splitlines()
    if not lines:
        return [], 0
    # A number that was cut off still looks like a number, so an unfinished line is not trusted.
    unfinished = len(lines) > 1 and not text.endswith("\n")
    whole = (_ACTION.sub(r"[\1 \2]", line) for line in (lines[:-1] if unfinished else lines))
    reader = csv.DictReader(_with_commas(list(whole)), skipinitialspace=True)
    try:
        _check_columns(file, reader.fieldnames or ())
        rows = [_step(row, line) for line, row in enumerate(reader)]
    except csv.Error as error:
        raise RecordingError(
            f"{file} is not a table ({error}). Take it out of the folder."
        ) from None
    steps = [row for row in rows if row is not None]
    return steps, len(rows) - len(steps) + unfinished


def _with_commas(lines: list[str]) -> list[str]:
    """Tables as spreadsheets save them: with ; or tabs, maybe with decimal commas."""
    separator = next((mark for mark in ";\t" if lines and mark in lines[0]), "")
    if not separator or "," in lines[0]:
        return lines
    return [line.replace(",", ".").replace(separator, ",") for line in lines]


def _check_columns(file: Path, names: Sequence[str]) -> None:
    missing = [name for name in _NEEDED if name not in names]
    if "action" not in names:
        missing += [name for name in ("steer", "throttle") if name not in names]
    if missing:
        raise RecordingError(
            f"{file} has no column {', '.join(missing)}. Its first line must name the columns as "
            "the reference simulator does: episode, steps, X, Y, yaw, steer, throttle and so on."
        )


def _step(row: dict[str, str], line: int) -> _Step | None:
    if None in row or None in row.values():
        return None
    x, y, yaw_deg, end_s = (_number(row.get(name)) for name in _NEEDED)
    steering_deg, speed_mps = _number(row.get("steer")), _number(row.get("throttle"))
    pair = _ACTION.fullmatch((row.get("action") or "").strip())
    if pair and not np.isfinite(steering_deg + speed_mps):
        steering_deg, speed_mps = (_number(text) for text in pair.groups())
    if not np.isfinite([x, y, yaw_deg, end_s, steering_deg, speed_mps]).all():
        return None
    count, progress = _number(row.get("steps")), _number(row.get("progress"))
    # A simulator that knew no status began its episodes with the same standing row.
    unknown = "prepare" if count == 1.0 else "in_progress"
    return _Step(
        line=line,
        episode=_whole(row.get("episode"), otherwise=0),
        count=count,
        pose=(x, y, float(np.radians(yaw_deg))),
        action=(steering_deg, speed_mps),
        end_s=end_s,
        status=row.get("episode_status") or unknown,
        progress=progress,
        waypoint=_whole(row.get("closest_waypoint"), otherwise=-1),
        wheels_on=_WHEELS_ON.get((row.get("all_wheels_on_track") or "").casefold(), -1),
        track_length_m=_number(row.get("track_len")),
    )


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return float("nan")


def _whole(text: str | None, *, otherwise: int) -> int:
    number = _number(text)
    return int(number) if np.isfinite(number) else otherwise


def _drives(steps: list[_Step]) -> Iterator[Recording]:
    cuts = [k for k in range(1, len(steps)) if _broken(steps[k - 1], steps[k])]
    for first, end in itertools.pairwise([0, *cuts, len(steps)]):
        part = steps[first:end]
        if not part:
            continue
        poses = np.array([step.pose for step in part])
        poses[:, 2] = np.unwrap(poses[:, 2])
        ends_s = np.array([step.end_s for step in part])
        held = part[0].status in _STANDING
        # In some episodes the first row still shows where the last one ended, the second the start.
        before = steps[first - 1]
        freed = first > 0 and not held and before.status in _STANDING and _next(before, part[0])
        yield Recording(
            episode=part[0].episode,
            poses=poses,
            actions=np.array([step.action for step in part]),
            starts_s=np.array([steps[first - 1].end_s if freed else np.nan, *ends_s[:-1]]),
            ends_s=ends_s,
            held=held,
            from_rest=held or freed,
            progress=np.array([step.progress for step in part]),
            waypoint=np.array([step.waypoint for step in part], np.int64),
            wheels_on=np.array([step.wheels_on for step in part], np.int64),
            track_length_m=part[0].track_length_m,
        )


def _next(before: _Step, now: _Step) -> bool:
    counted = now.count - before.count
    return (
        now.line == before.line + 1
        and now.episode == before.episode
        and 0.0 < now.end_s - before.end_s <= _LONGEST_STEP_S
        and (counted == 1.0 or not np.isfinite(counted))
    )


def _broken(before: _Step, now: _Step) -> bool:
    moved_m = np.hypot(now.pose[0] - before.pose[0], now.pose[1] - before.pose[1])
    return bool(
        not _next(before, now)
        or now.status in _STANDING
        or before.status not in _GOING_ON
        or moved_m > _JUMP_M + _FASTEST_MPS * (now.end_s - before.end_s)
    )
