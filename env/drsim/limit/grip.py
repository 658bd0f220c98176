"""What limits a lap: each car's grip and speed, as measured in the MuJoCo car.

With random requests (99 % of windows of 0.2 s are below), raised to the fastest driving: see
docs/track-limit.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

SPEEDS_MPS = (0.0, 0.5, 0.85, 1.1, 1.4, 1.6, 1.9, 2.1, 2.4, 2.6, 2.9, 3.1, 3.4, 3.65, 4.5)
"""Of `Grip.lateral_mps2`."""


@dataclass(frozen=True)
class Grip:
    """What a car can do at most.

    Attributes:
        lateral_mps2: At each of `SPEEDS_MPS`. All wheels turn at one speed, so a slow car
            understeers.
        best_brake_mps2: At which the car corners best.
        pull_per_s: Acceleration for each m/s below the top speed.
        jerk_mps3: Of lateral acceleration: steering lag and inertia.
    """

    lateral_mps2: tuple[float, ...]
    accelerate_mps2: float
    brake_mps2: float
    best_brake_mps2: float
    pull_per_s: float
    jerk_mps3: float
    top_mps: float


GRIPS: Mapping[str, Grip] = MappingProxyType(
    {
        "release-6": Grip(
            (0.0, 1.0, 2.2, 3.4, 4.7, 5.5, 6.1, 6.5, 7.2, 7.75, 8.15, 8.3, 8.1, 7.6, 7.6),
            accelerate_mps2=12.0,
            brake_mps2=12.0,
            best_brake_mps2=1.5,
            pull_per_s=9.5,
            jerk_mps3=75.0,
            top_mps=3.66,
        ),
        "low-grip": Grip(
            (0.0, 1.1, 2.4, 3.5, 4.2, 4.6, 4.9, 5.1, 5.4, 5.5, 5.6, 5.65, 5.65, 5.6, 5.6),
            accelerate_mps2=10.0,
            brake_mps2=10.0,
            best_brake_mps2=1.0,
            pull_per_s=7.5,
            jerk_mps3=50.0,
            top_mps=3.69,
        ),
        "2022": Grip(
            (0.0, 1.0, 3.0, 4.2, 4.6, 4.9, 5.1, 5.4, 5.7, 6.0, 6.0, 5.9, 5.7, 5.1, 5.1),
            accelerate_mps2=8.0,
            brake_mps2=7.0,
            best_brake_mps2=1.0,
            pull_per_s=4.0,
            jerk_mps3=30.0,
            top_mps=3.7,
        ),
    }
)
"""By names in `drsim.car.car_sets`."""
