"""Driven episodes from simtraces of ours or others."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from drcli.base.errors import SettingsError
from drcli.records.evaluation_task import RaceRecording
from drcli.records.iteration import counted_resets, is_clean_lap, lap_time
from drcli.records.trace import STATUS_LABELS, VIOLATIONS, TraceRow, read_rows
from drsim.arrays import Floats, Ints
from drsim.car.car import REFERENCE_POINT_AHEAD_M
from drsim.errors import TrackError
from drsim.track.track import Track
from drsim.track.worlds import known_worlds, load_track

JUMP_M = 0.6
"""Beyond this, the car was put there; it drives 0.27 m at most per row."""

LONGEST_STEP_S = 0.5
"""Longer: the simulator stood still, or rows are missing."""

LEAST_PROGRESS = 0.5
"""Percent of the lap; less is no way forward for a car that stands or turns in circles."""

LONGEST_S = 1800.0
"""Longer: a damaged clock."""


@dataclass(frozen=True, eq=False)
class RecordedLap:
    """An episode of a trace with t rows.

    Attributes:
        time_s: Since a step before the first row; rising.
        poses: x and y of the car's origin in metres, yaw in radians without jumps. Shape (t, 3).
        steering_deg: Requested, left positive.
        speed_mps: Requested.
        action: An index, or "[steering speed]".
        track_length_m: NaN if unknown.
        objects: Poses. Shape (t, k, 3).
        clock_s: From an unknown beginning.
        on_track: All wheels; None if unknown.
        pause_s: Rest of a penalty.
    """

    number: int
    time_s: Floats
    poses: Floats
    steering_deg: Floats
    speed_mps: Floats
    reward: Floats
    progress: Floats
    status: tuple[str, ...]
    action: tuple[str, ...]
    track_length_m: float
    objects: Floats
    steps: Floats
    clock_s: Floats
    on_track: tuple[bool | None, ...]
    pause_s: Floats

    @property
    def duration_s(self) -> float:
        """To the last row, as in metrics."""
        return float(self.time_s[-1])

    @property
    def progressed_s(self) -> float:
        """When the car came as far as it comes, to `LEAST_PROGRESS`."""
        return float(self.time_s[np.argmax(self.progress >= self.progress.max() - LEAST_PROGRESS)])

    @property
    def completed(self) -> bool:
        return self.status[-1] == "lap_complete"

    @property
    def resets(self) -> Ints:
        """Before each row; the last one does not count."""
        fresh = [before in VIOLATIONS and now != before for before, now in pairwise(self.status)]
        return np.cumsum([0, *fresh])

    @property
    def penalty_s(self) -> float:
        """Simulated; part of the duration."""
        waits = np.array([status == "pause" for status in self.status[1:]], bool)
        return float(np.diff(self.time_s)[waits].sum())

    @property
    def clean(self) -> bool:
        return is_clean_lap(self.completed, self.resets[-1], self.penalty_s)

    @property
    def told(self) -> str:
        """Such as "Finished: 12.80 s = 7.80 driven + 5.00 penalty, 1 reset"."""
        if not self.completed:
            return self.end
        time = lap_time(self.duration_s, self.penalty_s, int(self.resets[-1]))
        return f"{'Clean lap' if self.clean else 'Finished'}: {time}"

    @property
    def end(self) -> str:
        """Shorter: "Clean lap", "Finished, 1 reset"."""
        if self.clean:
            return "Clean lap"
        if self.completed:
            return f"Finished, {counted_resets(int(self.resets[-1]))}"
        return status_label(self.status[-1])

    @property
    def driven_mps(self) -> Floats:
        """From the poses of about a fifth of a second."""
        steps = np.hypot(*np.diff(self.poses[:, :2], axis=0).T)
        seconds = np.diff(self.time_s)
        put_back = np.diff(self.resets) > 0
        fine = (steps < JUMP_M) & (seconds > 1e-6) & ~put_back
        speeds = np.where(fine, steps / np.maximum(seconds, 1e-6), 0.0)
        padded = np.concatenate([speeds[:1], speeds, speeds[-1:]])
        return (padded[:-1] + padded[1:]) / 2.0 if len(speeds) else np.zeros(1)

    def with_objects(self, recording: RaceRecording) -> "RecordedLap":
        """Without any if they do not fit."""
        rows, count = len(self.time_s), len(recording.shapes)
        for episode in recording.episodes:
            if episode.episode != self.number:
                continue
            try:
                poses = np.array(episode.poses, np.float64)
            except ValueError:
                return self
            if poses.shape[1:] != (count, 3) or len(poses) < 1 or not np.isfinite(poses).all():
                return self
            at = np.minimum(np.arange(rows), len(poses) - 1)
            return replace(self, objects=poses[at])
        return self


def status_label(status: str) -> str:
    return STATUS_LABELS.get(status, status.replace("_", " ").capitalize())


def read_laps(data: bytes, origin: str) -> tuple[list[RecordedLap], list[str]]:
    """The episodes of a simtrace CSV of the reference or ours, and notes.

    Raises:
        SettingsError: It is not a simtrace, or without an episode of two rows.
    """
    found = read_rows(data)
    missing = [name for name in ("X", "Y", "yaw", "tstamp") if name not in found.names]
    if missing:
        raise SettingsError(
            f"{origin} is not a simtrace: its first line names no column {', '.join(missing)}.",
            remedy="Choose a file such as evaluation-simtrace/0-iteration.csv.",
        )
    readable = found.rows
    laps = []
    begin = short = cut = 0
    for end in range(1, len(readable) + 1):
        if end == len(readable) or _begins(readable[end - 1], readable[end]):
            part = _in_order(readable[begin:end])
            if len(part) > 1:
                laps.append(_lap(part, readable[begin - 1].time_s if begin else -math.inf))
                cut += end - begin - len(part)
            else:
                short += 1
            begin = end
    if not laps:
        raise SettingsError(
            f"{origin} holds no episode that can be shown: {len(readable)} rows can be read.",
            remedy="Choose another trace; each episode needs at least two rows.",
        )
    notes = [
        f"{origin}: {one if count == 1 else f'{count} {many}'}."
        for count, one, many in (
            (
                len(found.damaged),
                "1 line cannot be read and is left out",
                "lines cannot be read and are left out",
            ),
            (
                short,
                "1 episode has fewer than two rows and cannot be shown",
                "episodes have fewer than two rows and cannot be shown",
            ),
            (
                cut,
                "1 row has a wrong clock and is left out",
                "rows have a wrong clock and are left out",
            ),
        )
        if count
    ]
    return laps, notes


def _begins(before: TraceRow, row: TraceRow) -> bool:
    return row.episode != before.episode or row.steps < before.steps


def _pose(row: TraceRow) -> tuple[float, float, float]:
    yaw = math.radians(row.yaw_deg)
    ahead = REFERENCE_POINT_AHEAD_M
    return row.x - ahead * math.cos(yaw), row.y - ahead * math.sin(yaw), yaw


def _in_order(rows: list[TraceRow]) -> list[TraceRow]:
    kept = rows[:1]
    for row in rows[1:]:
        if row.time_s > kept[-1].time_s and row.time_s - rows[0].time_s <= LONGEST_S:
            kept.append(row)
    return kept


def _lap(rows: list[TraceRow], before_s: float) -> RecordedLap:
    status = [row.status for row in rows]
    if rows[-1].progress >= 100.0 and status[-1] == "in_progress":
        status[-1] = "lap_complete"  # simulators of 2022 leave it in_progress
    poses = np.array([_pose(row) for row in rows])
    poses[:, 2] = np.unwrap(poses[:, 2])
    time_s = np.array([row.time_s for row in rows])
    # Where the simulator stood still, the film does not.
    pauses = np.diff(time_s)
    steps = np.minimum(pauses, LONGEST_STEP_S)
    # A row is the end of its step. An episode in a race without a stop begins where the one
    # before it ended.
    usual_s = float(np.median(steps))
    gap_s = rows[0].time_s - before_s
    first_s = gap_s if 0.0 < gap_s <= 2.0 * usual_s else usual_s
    return RecordedLap(
        number=rows[0].episode,
        time_s=first_s + np.concatenate([[0.0], np.cumsum(steps)]),
        poses=poses,
        steering_deg=np.nan_to_num([row.steering_deg for row in rows]),
        speed_mps=np.nan_to_num([row.speed_mps for row in rows]),
        reward=np.nan_to_num([row.reward for row in rows]),
        progress=np.nan_to_num([row.progress for row in rows]),
        status=tuple(status),
        action=tuple(row.action for row in rows),
        track_length_m=rows[-1].track_length_m,
        objects=np.empty((len(rows), 0, 3)),
        steps=np.nan_to_num([row.steps for row in rows]),
        clock_s=time_s,
        on_track=tuple(row.on_track for row in rows),
        pause_s=np.nan_to_num([row.pause_s for row in rows]),
    )


# Finds a trace's track by its laps.


SAME_LENGTH = 0.002
"""Tolerance as a share: a trace counts centimetres."""

LEAST_ON_ROAD = 0.6
"""Share of rows: beginners' models leave the road, but not for long."""


def load_world(name: str, folder: Path | None) -> Track:
    """Raises SettingsError for a missing or damaged track."""
    try:
        return load_track(name, folder)
    except TrackError as error:
        raise SettingsError(
            f"The track {name:.80} cannot be shown: {error}",
            remedy="Fetch it with `dr-tracks fetch NAME`, or name another one with --world.",
        ) from None


def find_world(laps: Sequence[RecordedLap], first: str, folder: Path | None, origin: str) -> Track:
    """The track that the laps fit on; tries `first` first.

    Raises:
        SettingsError: They fit on none.
    """
    points = np.concatenate([lap.poses[:, :2] for lap in laps])
    points = points[:: max(1, len(points) // 2000)]
    length_m = next((lap.track_length_m for lap in laps if lap.track_length_m > 0), math.nan)
    best, best_share = None, 0.0
    for name in dict.fromkeys([first, *known_worlds(folder)]):
        try:
            track = load_track(name, folder)
        except TrackError:
            continue
        if abs(track.length_m - length_m) > max(SAME_LENGTH * track.length_m, 0.02):
            continue
        share = float(track.on_road(points).mean())
        if share > best_share and share >= LEAST_ON_ROAD:
            best, best_share = track, share
        if share > 0.98:
            break
    if best is None:
        text = "" if math.isnan(length_m) else f" of {length_m:.2f} m"
        raise SettingsError(
            f"{origin} does not name its track, and no installed one{text} fits it.",
            remedy="Name the track with --world; `dr-tracks list` shows what is installed, and "
            "`dr-tracks fetch NAME` brings others.",
        )
    return best
