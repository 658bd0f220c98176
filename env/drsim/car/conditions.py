"""The conditions in which one episode differs from the nominal car and camera."""

import math
from dataclasses import dataclass, fields
from typing import Any

_FACTORS = ("brightness", "friction", "mass", "battery", "steering_left", "steering_right")
_SHARES = ("glare", "reflections")
_NOT_NEGATIVE = ("image_noise", "blur_px", "latency_s")

MOST_TRIM_DEG = 20.0
MOST_FACTOR = 2.0


@dataclass(frozen=True)
class Conditions:
    """What an episode is driven under. The default is the nominal car in the usual light.

    `Realism` draws one for each episode; `Simulation.reset` takes a known one.

    Attributes:
        image_noise: Standard deviation in every pixel, greys.
        brightness: Factor on greys.
        blur_px: Standard deviation of a Gaussian.
        glare: Of a lamp that shines into the lens, 0 .. 1.
        reflections: Of lamps, by the floor, 0 .. 1.
        camera_turn_deg: Roll, pitch, yaw.
        camera_shift_m: Forward, left, up.
        latency_s: Actions act this much later.
        friction: Factor on grip.
        mass: Factor on mass and inertia.
        battery: Factor on speed reached and torque.
        steering_trim_deg: Further to the left than requested.
        steering_left: Factor on angles to the left.
        steering_right: Likewise.
        pattern: Fixes the noise of each pixel, and where lamps are.
    """

    image_noise: float = 0.0
    brightness: float = 1.0
    blur_px: float = 0.0
    glare: float = 0.0
    reflections: float = 0.0
    camera_turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    latency_s: float = 0.0
    friction: float = 1.0
    mass: float = 1.0
    battery: float = 1.0
    steering_trim_deg: float = 0.0
    steering_left: float = 1.0
    steering_right: float = 1.0
    pattern: int = 0

    def __post_init__(self) -> None:
        """Raise ValueError for a value that cannot be."""
        for name in _FACTORS:
            if not 0.0 < getattr(self, name) <= MOST_FACTOR:
                self._refuse(name, f"more than 0 and at most {MOST_FACTOR:g}")
        for name in _SHARES:
            if not 0.0 <= getattr(self, name) <= 1.0:
                self._refuse(name, "0 .. 1")
        for name in _NOT_NEGATIVE:
            if not 0.0 <= getattr(self, name) < math.inf:
                self._refuse(name, "0 or more")
        for name in ("camera_turn_deg", "camera_shift_m"):
            values = getattr(self, name)
            if len(values) != 3 or not all(math.isfinite(value) for value in values):
                self._refuse(name, "three finite numbers")
        if not abs(self.steering_trim_deg) <= MOST_TRIM_DEG:
            self._refuse("steering_trim_deg", f"within {MOST_TRIM_DEG:g} degrees to either side")
        if not 0 <= self.pattern < 2**64:
            self._refuse("pattern", "a whole number from 0 to 2**64 - 1")

    def _refuse(self, name: str, allowed: str) -> None:
        raise ValueError(f"{name} is {getattr(self, name)}; it must be {allowed}.")

    @property
    def changes_car(self) -> bool:
        return any(getattr(self, name) != getattr(NOMINAL, name) for name in _OF_CAR)

    def to_dict(self) -> dict[str, Any]:
        every = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: value for name, value in every.items() if value != getattr(NOMINAL, name)}


_OF_CAR = (
    "latency_s",
    "friction",
    "mass",
    "battery",
    "steering_trim_deg",
    "steering_left",
    "steering_right",
)

NOMINAL = Conditions()
