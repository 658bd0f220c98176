"""Speed and slip angle of a car, from its positions."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

REAR_M = 0.222
"""From the rear axle to the recorded point, measured on recordings of the reference."""

LEAST_MOTION_M = 0.02
_FASTEST_MPS = 12.0
"""Three times the fastest car."""


def slip_deg(x: Floats, y: Floats, yaw_deg: Floats, first: NDArray[np.bool_]) -> Floats:
    """Slip angle within [-180, 180), positive where the car moves to the left of its nose.

    The rear axle of a car that does not slide moves where the car points. NaN where the car hardly
    moved, and in `first` rows of episodes. All have shape (n,).
    """
    slip: Floats = np.full(len(x), np.nan)
    if len(x) < 2:
        return slip
    yaw_rad = np.radians(yaw_deg)
    rear = np.stack([x - REAR_M * np.cos(yaw_rad), y - REAR_M * np.sin(yaw_rad)], axis=1)
    motion = np.diff(rear, axis=0)
    turn_deg = _wrapped(np.diff(yaw_deg))
    heading_deg = yaw_deg[:-1] + turn_deg / 2
    angle_deg = _wrapped(np.degrees(np.arctan2(motion[:, 1], motion[:, 0])) - heading_deg)
    moved = np.hypot(*motion.T) >= LEAST_MOTION_M
    slip[1:] = np.where(moved & ~first[1:], angle_deg, np.nan)
    return slip


def driven_mps(x: Floats, y: Floats, time_s: Floats, first: NDArray[np.bool_]) -> Floats:
    """Speed over ground since the step before; NaN after a jump. All have shape (n,)."""
    speed: Floats = np.full(len(x), np.nan)
    if len(x) < 2:
        return speed
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.hypot(np.diff(x), np.diff(y)) / np.diff(time_s)
    fine = ~first[1:] & np.isfinite(found) & (found >= 0.0) & (found <= _FASTEST_MPS)
    speed[1:] = np.where(fine, found, np.nan)
    return speed


def _wrapped(angle_deg: Floats) -> Floats:
    return (angle_deg + 180.0) % 360.0 - 180.0
