"""How near our car and our track come to recordings: poses ahead, and columns such as progress.

Our car gets the same actions for the same times, and a bicycle that does at once what it is asked
drives beside it. Each drive is driven once, and each
window is a piece of it, moved to the recorded pose: the floor is flat, so this equals stepping
before every window, and is thirty times faster.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.car.car import (
    COMMAND_RADIUS_M,
    REAR_AXLE_BEHIND_M,
    REFERENCE_POINT_AHEAD_M,
    WHEEL_RADIUS_M,
    WHEELBASE_M,
    CarBatch,
    car_model,
    motor_commands,
)
from drsim.car.car_parameters import MAX_SPEED_MPS, MAX_STEERING_DEG, MIN_SPEED_MPS, CarParameters
from drsim.car.physics import PhysicsChoice, choose_physics
from drsim.episode.episode_rules import advance_progress
from drsim.fidelity.recordings import Recording
from drsim.track.polyline import Location
from drsim.track.track import Track

SETTLING_ROWS = 3
"""The reference may put a car at its start with the speed that it had before."""

WARM_UP_S = 1.0
"""Earlier after a break it is unknown how the car moved."""

_OFF_HORIZON_S = 0.05
_SETTLE_S = 1.0
_CARS = 256


@dataclass(frozen=True)
class Windows:
    """How far our car and the bicycle ended from the recorded car.

    `driven_m` is how far that got. Shape (w,).
    """

    position_m: Floats
    yaw_deg: Floats
    bicycle_position_m: Floats
    bicycle_yaw_deg: Floats
    driven_m: Floats


def compare_motion(
    drives: Sequence[Recording],
    parameters: CarParameters | None = None,
    *,
    horizon_s: float = 1.0,
    physics: PhysicsChoice = "mujoco",
) -> Windows:
    """Replay drives and compare poses `horizon_s` ahead, from every row that allows it."""
    found = [np.empty((0, 5))]
    for drive, replayed in zip(drives, replay(drives, parameters, physics), strict=True):
        first, last = _windows(drive, horizon_s)
        if not len(first):
            continue
        real = _seen_from(drive.poses[first], drive.poses[last])
        ours = _seen_from(replayed[first], replayed[last])
        bicycle = _seen_from(drive.poses[first], _bicycle(drive, first, last))
        found.append(
            np.stack(
                [*_apart(real, ours), *_apart(real, bicycle), np.hypot(*real[:, :2].T)], axis=1
            )
        )
    return Windows(*np.concatenate(found).T)


def replay(
    drives: Sequence[Recording],
    parameters: CarParameters | None = None,
    physics: PhysicsChoice = "mujoco",
) -> list[Floats]:
    """Drive the recorded actions, each for its recorded time.

    Returns poses at the start of every row: x and y (metres) of the point 0.14 m ahead of the
    car's origin, and yaw (radians). Shape (t, 3).
    """
    parameters = parameters or CarParameters()
    found: list[Floats] = [np.empty((0, 3))] * len(drives)
    by_length = sorted(range(len(drives)), key=lambda k: len(drives[k].poses))
    for begin in range(0, len(drives), _CARS):
        chosen = by_length[begin : begin + _CARS]
        together = _replay_together([drives[k] for k in chosen], parameters, physics)
        for k, poses in zip(chosen, together, strict=True):
            found[k] = poses
    return found


def _replay_together(
    drives: Sequence[Recording], parameters: CarParameters, physics: PhysicsChoice
) -> list[Floats]:
    model = car_model(parameters)
    engine, _ = choose_physics(physics, model, len(drives), os.cpu_count() or 1)
    ctrl = np.zeros((len(drives), model.nu))
    qpos = np.repeat(model.qpos0[None], len(drives), axis=0)
    half_yaw = np.array([drive.poses[0, 2] for drive in drives]) / 2
    qpos[:, 3], qpos[:, 6] = np.cos(half_yaw), np.sin(half_yaw)
    engine.place(np.arange(len(drives)), qpos)
    engine.step(ctrl, None, round(_SETTLE_S / model.opt.timestep))
    rows = np.array([len(drive.poses) for drive in drives])
    poses = np.zeros((len(drives), int(rows.max()), 3))
    until = np.zeros(poses.shape[:2], np.int64)
    actions = np.zeros((*poses.shape[:2], 2))
    for k, drive in enumerate(drives):
        until[k, : rows[k]] = _steps_until(drive, model.opt.timestep)
        actions[k, : rows[k]] = drive.actions
    done = np.zeros(len(drives), np.int64)
    for row in range(poses.shape[1]):
        poses[:, row] = _poses(engine.qpos)
        steering_rad, wheel_rad_s = motor_commands(
            actions[:, row, 0], actions[:, row, 1], parameters
        )
        ctrl[:, :2] = steering_rad[:, None]
        ctrl[:, 2:] = wheel_rad_s[:, None]
        todo = np.where(row < rows, until[:, row] - done, 0)
        for steps in np.unique(todo[todo > 0]):
            engine.step(ctrl, np.flatnonzero(todo == steps), int(steps))
        done += todo
    return [poses[k, : rows[k]] for k in range(len(drives))]


def _steps_until(drive: Recording, step_s: float) -> Ints:
    began_s = drive.starts_s[0]
    if drive.held or math.isnan(began_s):
        began_s = drive.ends_s[0]
    return np.asarray(np.rint((drive.ends_s - began_s) / step_s).astype(np.int64))


def _poses(qpos: Floats) -> Floats:
    w, a, b, c = qpos[:, 3:7].T
    forward_x, forward_y = 1 - 2 * (b * b + c * c), 2 * (a * b + w * c)
    x = qpos[:, 0] + REFERENCE_POINT_AHEAD_M * forward_x
    y = qpos[:, 1] + REFERENCE_POINT_AHEAD_M * forward_y
    return np.stack([x, y, np.arctan2(forward_y, forward_x)], axis=1)


def _windows(drive: Recording, horizon_s: float) -> tuple[Ints, Ints]:
    starts_s = drive.starts_s
    if drive.from_rest:
        allowed = np.arange(len(starts_s)) >= SETTLING_ROWS
    else:
        allowed = starts_s >= np.nanmin([*starts_s, np.inf]) + WARM_UP_S
    first = np.flatnonzero(allowed)
    after = np.searchsorted(starts_s[1:], starts_s[first] + horizon_s) + 1
    last = np.minimum(after, len(starts_s) - 1)
    before = np.maximum(last - 1, 0)
    wanted_s = starts_s[first] + horizon_s
    last = np.where(wanted_s - starts_s[before] < starts_s[last] - wanted_s, before, last)
    near = (np.abs(starts_s[last] - wanted_s) <= _OFF_HORIZON_S) & (last > first)
    return first[near], last[near]


def _bicycle(drive: Recording, first: Ints, last: Ints) -> Floats:
    """It follows requests at once and never slips."""
    steering_rad = np.radians(np.clip(drive.actions[:, 0], -MAX_STEERING_DEG, MAX_STEERING_DEG))
    wheel_rad_s = np.clip(drive.actions[:, 1], MIN_SPEED_MPS, MAX_SPEED_MPS) / COMMAND_RADIUS_M
    way_m = wheel_rad_s * WHEEL_RADIUS_M * (drive.ends_s - drive.starts_s)
    turn_rad = way_m * np.tan(steering_rad) / WHEELBASE_M
    x, y, yaw = _ahead(drive.poses[first], -REAR_AXLE_BEHIND_M).T
    for k in range(int((last - first).max())):
        on = first + k < last
        row = first[on] + k
        # On an arc the chord points halfway between the headings at its ends.
        middle = yaw[on] + turn_rad[row] / 2
        chord_m = way_m[row] * np.sinc(turn_rad[row] / (2 * np.pi))
        x[on] += chord_m * np.cos(middle)
        y[on] += chord_m * np.sin(middle)
        yaw[on] += turn_rad[row]
    return _ahead(np.stack([x, y, yaw], axis=1), REAR_AXLE_BEHIND_M)


def _ahead(poses: Floats, distance_m: float) -> Floats:
    x, y, yaw = poses.T
    return np.stack([x + distance_m * np.cos(yaw), y + distance_m * np.sin(yaw), yaw], axis=1)


def _seen_from(poses: Floats, others: Floats) -> Floats:
    dx, dy, turn = (others - poses).T
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)


def _apart(poses: Floats, others: Floats) -> tuple[Floats, Floats]:
    distance_m = np.hypot(*(poses - others)[:, :2].T)
    turn_rad = (poses[:, 2] - others[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return distance_m, np.abs(np.degrees(turn_rad))


PROGRESS_TOLERANCE = 0.02
"""Percent of a lap; 3 mm of a short one."""

_LENGTH_TOLERANCE = 0.01
_FURTHEST_M = 2.0


@dataclass(frozen=True)
class Agreement:
    """Shares of recorded rows whose columns agree, 0 .. 1; NaN where the column is missing.

    Attributes:
        progress: Within `PROGRESS_TOLERANCE`; others are equal.
        reverse: Driven against the direction of the track.
        fits: The recording may be of this track.
    """

    progress: float
    closest_waypoint: float
    all_wheels_on_track: float
    rows: int
    length_m: float
    recorded_length_m: float
    reverse: bool
    fits: bool


def compare_track_columns(drives: Sequence[Recording], track: Track) -> Agreement:
    poses = np.concatenate([drive.poses for drive in drives])
    waypoint = np.concatenate([drive.waypoint for drive in drives])
    wheels_on = np.concatenate([drive.wheels_on for drive in drives])
    lengths_m = np.array([drive.track_length_m for drive in drives])
    lengths_m = lengths_m[np.isfinite(lengths_m)]
    recorded_m = float(np.median(lengths_m)) if len(lengths_m) else float("nan")

    ways = [(way, way.locate(poses[:, :2])) for way in (track, track.reversed())]
    way, where = max(ways, key=lambda both: np.mean(both[1].nearest == waypoint))
    known = wheels_on >= 0
    on = all_wheels_on(poses[known], way)
    near_m = float(np.median(where.from_center_m))
    too_long = abs(recorded_m - track.length_m) > _LENGTH_TOLERANCE * track.length_m
    return Agreement(
        progress=_share(np.abs(_progress_errors(drives, where, way)) <= PROGRESS_TOLERANCE),
        closest_waypoint=_share((where.nearest == waypoint)[waypoint >= 0]),
        all_wheels_on_track=_share(on == wheels_on[known]),
        rows=len(poses),
        length_m=track.length_m,
        recorded_length_m=recorded_m,
        reverse=way.reverse != track.reverse,
        fits=near_m <= _FURTHEST_M and not too_long,
    )


def all_wheels_on(poses: Floats, track: Track) -> Bools:
    """Whether all four wheels of standing cars are on the road; poses as in `Recording`."""
    if not len(poses):
        return np.zeros(0, np.bool_)
    yaw = poses[:, 2]
    ahead_m = REFERENCE_POINT_AHEAD_M * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    cars = CarBatch(len(poses), 1)
    cars.place(np.arange(len(poses)), np.column_stack([poses[:, :2] - ahead_m, yaw]))
    return np.asarray(np.all(track.on_road(cars.wheel_xy), axis=1))


def _progress_errors(drives: Sequence[Recording], where: Location, track: Track) -> Floats:
    fraction = where.distance_m / track.length_m
    errors, row = [np.empty(0)], 0
    for drive in drives:
        recorded, here = drive.progress, fraction[row : row + len(drive.progress)]
        row += len(recorded)
        start = np.full(len(recorded), here[0] - recorded[0] / 100.0) % 1.0
        before = np.where(recorded >= 100.0, 0.0, recorded)[:-1]
        found = advance_progress(before, here[1:], start[1:])
        errors.append((found - recorded[1:])[np.isfinite(recorded[1:] + before)])
    return np.concatenate(errors)


def _share(right: Bools) -> float:
    return float(right.mean()) if len(right) else float("nan")
