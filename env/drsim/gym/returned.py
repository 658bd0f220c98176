"""What both environments return: observations and info."""

from typing import Any

import numpy as np

from drsim.episode.simulation import Simulation
from drsim.episode.step import StepResult
from drsim.sensing.sensors import Sensors

Perceived = Any
"""An array, or a dict of arrays by sensor name."""

_INFO = (
    *("progress", "status", "steps", "laps", "lap_time_s", "x", "y", "yaw_deg"),
    *("closest_waypoint", "all_wheels_on_track", "crashes", "driven"),
)


def perceived(simulation: Simulation, sensors: Sensors, cars: int | slice) -> Perceived:
    """Copies, eyes last."""
    frames = np.moveaxis(simulation.frames[cars], -3, -1).copy()
    if sensors.lidar is None:
        return frames
    return {sensors.camera: frames, sensors.lidar: simulation.scans[cars].copy()}


def info_of(result: StepResult) -> dict[str, Any]:
    return {name: getattr(result, name) for name in _INFO}
