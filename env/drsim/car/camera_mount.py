"""The front camera's mount, field of view and resolution."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class CameraModel:
    """A front camera. Source of the defaults: the reference simulator.

    Attributes:
        mount_m: In the car's base frame: forward, left, up.
        pitch_rad: Nose down. The car rests 1.39 degrees nose up, so a resting lens looks 13.6
            degrees down.
        field_of_view_rad: Horizontal.
    """

    mount_m: tuple[float, float, float] = (0.145294, 0.0, 0.130326)
    pitch_rad: float = 0.2618
    field_of_view_rad: float = 1.13
    columns: int = 160
    rows: int = 120

    @property
    def focal_px(self) -> float:
        return 0.5 * self.columns / math.tan(0.5 * self.field_of_view_rad)


FRONT = CameraModel()
EYES_APART_M = 0.06
"""Source: the reference simulator."""
