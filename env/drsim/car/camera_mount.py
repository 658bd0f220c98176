"""The front camera of the car: its mount, field of view and resolution."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class CameraModel:
    """Numbers of a front camera. Source of the defaults: the reference simulator's car model.

    Attributes:
        mount_m: Lens in the car's base frame: forward, left, up.
        pitch_rad: Tilt of the lens relative to the chassis, nose down positive. The car rests
            1.39 degrees nose up, so a resting lens looks 13.6 degrees down.
        field_of_view_rad: Horizontal opening angle.
        columns: Width of a frame in pixels.
        rows: Height of a frame in pixels; pixels are square, the optical axis is in the middle.
    """

    mount_m: tuple[float, float, float] = (0.145294, 0.0, 0.130326)
    pitch_rad: float = 0.2618
    field_of_view_rad: float = 1.13
    columns: int = 160
    rows: int = 120

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.columns / math.tan(0.5 * self.field_of_view_rad)


FRONT = CameraModel()
"""The one camera of a car without stereo."""

EYES_APART_M = 0.06
"""Distance between the two cameras of a car with stereo. Source: the reference simulator."""
