"""Scripted drivers: what each asks of its car, from what reward functions are told."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drsim.car.car import REAR_AXLE_BEHIND_M, WHEELBASE_M
from drsim.episode.reward import RewardParams
from drsim.track.track import Track

Floats = NDArray[np.float64]

Manner = Literal["along", "weave", "leave", "ram"]

_LOOK_AHEAD_M, _LOOK_AHEAD_S = 0.45, 0.18
"""A pilot steers towards a point this far ahead, and so much farther with its speed."""

_BRAKING_MPS2 = 2.0
_PROFILE_M = 0.1
_BEND_M = 0.5
"""Spacing of the speed profile, and the length over which a bend is measured."""

_WEAVE_M = 4.0
"""Length of one swing to the left border and the right one."""

_LEAVE_AFTER_M = 1.0

_SEES_M, _PASSED_M = 2.2, 0.5
"""How far before an object pilots keep to the other side, and how far beyond it."""

_PASSING_MPS = 1.5
"""Highest speed beside an object."""

_SLOWEST_START_MPS = 1.0
"""Nobody can drive faster in the first step, while nothing is known yet."""


@dataclass(frozen=True)
class Pilot:
    """A way to drive.

    Attributes:
        name: One word.
        about: What it does, for people.
        manner: Along the centre line round what stands there, from border to border, off the road,
            or into the next object.
        speed_mps: Its highest speed.
        grip_mps2: Sideways acceleration that it drives bends with; None to keep its speed.
        laps: It drives on to the end of the lap, whatever happens; else its first mishap, or
            `steps`, ends the trip.
        steps: Steps that are enough.
        start: Where on the lap it starts, 0 .. 1 from the common start.
        turned: It drives against the direction of the others.
    """

    name: str
    about: str
    manner: Manner
    speed_mps: float
    grip_mps2: float | None = None
    laps: bool = True
    steps: int = 10_000
    start: float = 0.0
    turned: bool = False


STEADY = Pilot("steady", "follows the centre line at 1.2 m/s", "along", 1.2)
FAST = Pilot("fast", "follows the centre line at up to 3 m/s", "along", 3.0, grip_mps2=2.0)
WEAVING = Pilot("weaving", "swings from border to border at 1 m/s", "weave", 1.0)
LEAVING = Pilot("leaving", "leaves the road", "leave", 1.2, laps=False, start=0.3)
STANDING = Pilot(
    "standing", "asks for no speed and creeps", "along", 0.0, laps=False, steps=60, start=0.5
)
RAMMING = Pilot("ramming", "drives into what is on the road", "ram", 1.5, laps=False)
TURNED = Pilot(
    "turned",
    "follows the centre line the other way",
    "along",
    1.2,
    laps=False,
    steps=60,
    turned=True,
)


class Navigator:
    """Drives one car as its pilot wants.

    Args:
        pilot: The way to drive.
        track: The track, in the driving direction of this car.
    """

    def __init__(self, pilot: Pilot, track: Track) -> None:
        self.pilot = pilot
        self._track = track
        self._speeds_mps = _speed_profile(track, pilot)
        self._begun_m: float | None = None

    def first(self) -> tuple[float, float]:
        """Steering angle and speed of the first step, before anything is known."""
        return 0.0, min(self.pilot.speed_mps, _SLOWEST_START_MPS)

    def act(self, params: RewardParams) -> tuple[float, float]:
        """Steering angle in degrees and speed in m/s, from the parameters of the last step."""
        along_m = params["projection_distance"]
        if self._begun_m is None:
            self._begun_m = along_m
        side = self._blocked_side(params)
        speed_mps = self._speed_at(along_m)
        ahead_m = _LOOK_AHEAD_M + _LOOK_AHEAD_S * speed_mps
        if side:
            speed_mps, ahead_m = min(speed_mps, _PASSING_MPS), _LOOK_AHEAD_M
        x, y, yaw_rad = self._track.pose_at(np.array([along_m + ahead_m]))[0].tolist()
        aside_m = self._aside_m(params, along_m + ahead_m, side)
        x, y = x - aside_m * math.sin(yaw_rad), y + aside_m * math.cos(yaw_rad)
        return _steering_deg(params, x, y), speed_mps

    def _speed_at(self, along_m: float) -> float:
        last = len(self._speeds_mps) - 1
        return float(self._speeds_mps[min(int(along_m / _PROFILE_M), last)])

    def _aside_m(self, params: RewardParams, target_m: float, side: int) -> float:
        """How far to the left of the centre line to aim, metres."""
        width_m = float(params["track_width"])
        manner = self.pilot.manner
        if manner == "leave":
            gone_m = self._gap_m(params["projection_distance"], self._begun_m or 0.0)
            return (-side or 1) * 1.5 * width_m if gone_m > _LEAVE_AFTER_M else 0.0
        if side and manner == "ram":
            return side * width_m / 4
        if side:
            return -side * width_m / 3
        if manner == "weave":
            return 0.37 * width_m * math.sin(2 * math.pi * target_m / _WEAVE_M)
        return 0.0

    def _blocked_side(self, params: RewardParams) -> int:
        """1 where the nearest object ahead is on the left, -1 on the right, 0 without one."""
        gaps_m = [
            self._gap_m(there_m, params["projection_distance"])
            for there_m in params["objects_distance"]
        ]
        near = [k for k, gap_m in enumerate(gaps_m) if -_PASSED_M < gap_m < _SEES_M]
        if not near:
            return 0
        nearest = min(near, key=lambda k: abs(gaps_m[k]))
        return 1 if params["objects_left_of_center"][nearest] else -1

    def _gap_m(self, there_m: float, here_m: float) -> float:
        """How far ahead something is along the lap, negative behind."""
        gap_m = there_m - here_m
        if not self._track.closed:
            return gap_m
        half_m = self._track.length_m / 2
        return (gap_m + half_m) % (2 * half_m) - half_m


def _steering_deg(params: RewardParams, x: float, y: float) -> float:
    """The angle that leads the rear axle to a point in an arc."""
    yaw_rad = math.radians(params["heading"])
    rear_x = params["x"] - REAR_AXLE_BEHIND_M * math.cos(yaw_rad)
    rear_y = params["y"] - REAR_AXLE_BEHIND_M * math.sin(yaw_rad)
    away_m = max(math.hypot(x - rear_x, y - rear_y), 0.1)
    turn_rad = math.atan2(y - rear_y, x - rear_x) - yaw_rad
    angle_deg = math.degrees(math.atan2(2 * WHEELBASE_M * math.sin(turn_rad), away_m))
    return max(-30.0, min(30.0, angle_deg))


def _speed_profile(track: Track, pilot: Pilot) -> Floats:
    """Speeds along the lap, every 0.1 m: slow enough for each bend and for braking before it."""
    along_m = np.arange(0.0, track.length_m + _PROFILE_M, _PROFILE_M)
    if pilot.grip_mps2 is None:
        return np.full(len(along_m), pilot.speed_mps)
    yaw_before, yaw_after = (
        track.pose_at(along_m + aside_m)[:, 2] for aside_m in (-_BEND_M / 2, _BEND_M / 2)
    )
    turn_rad = np.abs((yaw_after - yaw_before + np.pi) % (2 * np.pi) - np.pi)
    bend_mps = np.sqrt(pilot.grip_mps2 * _BEND_M / np.maximum(turn_rad, 1e-6))
    speeds_mps = np.minimum(bend_mps, pilot.speed_mps)
    rounds = 2 if track.closed else 1  # the braking before a bend may begin before the finish
    for k in range(rounds * len(speeds_mps) - 1, 0, -1):
        here, after = (k - 1) % len(speeds_mps), k % len(speeds_mps)
        reached = math.sqrt(speeds_mps[after] ** 2 + 2 * _BRAKING_MPS2 * _PROFILE_M)
        speeds_mps[here] = min(speeds_mps[here], reached)
    return speeds_mps
