"""What a car may be asked for, and the calibrated parameters of its motion."""

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from drsim.errors import require

MAX_STEERING_DEG = 30.0
MIN_SPEED_MPS = 0.1
MAX_SPEED_MPS = 4.0
"""Limits of requests. Source: the reference simulator."""

MOST_LOCK_DEG = 60.0
_MAY_BE_ZERO = ("steering_lag_s", "steering_delay_s", "speed_delay_s", "speed_lag_s")
_MAY_BE_NEGATIVE = ("steering_trim_deg",)


@dataclass(frozen=True)
class CarParameters:
    """The calibrated numbers of the car; masses and geometry are in car.xml.

    Found by replaying half of the episodes recorded in the reference simulator (release 6). On the
    others the median error after one second is 0.081 m and 3.9 degrees, 1.55 m driven.
    """

    steering_lag_s: float = 0.1255
    """Time constant of the wheels' angle."""
    steering_delay_s: float = 0.0095
    """Before a request acts; never less than one physics step."""
    speed_delay_s: float = 0.0095
    speed_lag_s: float = 0.0
    """Time constant of the motors; 0: at once."""
    wheel_damping: float = 0.0505
    """Torque per speed error, N m s/rad. All wheels have one speed, so this decides how far the
    car understeers.
    """
    wheel_torque: float = 1.79
    """Largest of a motor, N m."""
    friction: float = 0.9
    """Grip across the wheels' plane (0.5 in the reference, whose engine's mixing is unknown)."""
    traction: float = 3.33
    """Grip along it. The recorded car reaches 1.4 m/s in two steps, so wheels hardly spin."""
    twist_friction_m: float = 0.0151
    """Against turning on the spot: torque over load."""
    tyre_time_s: float = 0.042
    """Of a tyre that is pushed into the floor or slides; at least twice the physics step."""
    tyre_impedance: float = 0.479
    """0 .. 1, small is soft. It decides how deep a standing car sinks in (2.4 mm, which car.xml
    makes up for) and how far wheels creep.
    """
    speed_scale: float = 0.998
    max_wheel_rad_s: float = 100.0
    """4 m/s asks for 114 rad/s, so about 3.6 m/s is the fastest."""
    substeps: int = 7
    """9.5 ms each. With 20, errors are 2 mm smaller."""
    steering_left_deg: float = MAX_STEERING_DEG
    """The real angle at the greatest request; smaller ones are scaled."""
    steering_right_deg: float = MAX_STEERING_DEG
    steering_trim_deg: float = 0.0
    """At a request of 0, left positive."""
    battery: float = 1.0
    """Factor on wheel speed and torque."""
    max_speed_mps: float = MAX_SPEED_MPS

    def __post_init__(self) -> None:
        """Raise ValueError for a number that no car can have."""
        for name, value in vars(self).items():
            if name in _MAY_BE_NEGATIVE:
                continue
            zero = name in _MAY_BE_ZERO
            least = "be 0 or more" if zero else "be more than 0"
            require(0.0 <= value < math.inf and (value > 0.0 or zero), name, value, least)
        for name in ("steering_left_deg", "steering_right_deg", "steering_trim_deg"):
            value = getattr(self, name)
            require(abs(value) <= MOST_LOCK_DEG, name, value, f"be at most {MOST_LOCK_DEG:g}")
        fastest, impedance = self.max_speed_mps, self.tyre_impedance
        least = f"be more than {MIN_SPEED_MPS}, the least speed of a car"
        require(fastest > MIN_SPEED_MPS, "max_speed_mps", fastest, least)
        require(impedance < 1.0, "tyre_impedance", impedance, "be less than 1")
        whole = self.substeps == int(self.substeps)
        require(whole, "substeps", self.substeps, "be a whole number")


# Car parameters by name: the cars that models of other years have learned.


@dataclass(frozen=True)
class CarSet:
    """Parameters with a name.

    Attributes:
        origin: Where the numbers come from and which models they suit.
    """

    name: str
    parameters: CarParameters
    origin: str


DEFAULT_CAR = "release-6"
_SETS = (
    CarSet(
        DEFAULT_CAR,
        CarParameters(),
        "Fitted to a training in the reference simulator's release 6 (2026). For new models.",
    ),
    CarSet(
        "low-grip",
        CarParameters(
            steering_lag_s=0.1163,
            speed_delay_s=0.0104,
            wheel_damping=0.0282,
            wheel_torque=2.12,
            friction=0.6,
            traction=3.24,
            twist_friction_m=0.011,
            tyre_time_s=0.0519,
            tyre_impedance=0.488,
            speed_scale=0.989,
        ),
        "Fitted to the same training with the grip kept at 0.6. For models from before release 6 "
        "that leave the track with the default car.",
    ),
    CarSet(
        "2022",
        CarParameters(
            steering_lag_s=0.392,
            speed_lag_s=0.2265,
            wheel_damping=0.0669,
            wheel_torque=0.735,
            friction=0.646,
            traction=2.56,
            twist_friction_m=0.0078,
            tyre_time_s=0.0329,
            tyre_impedance=0.258,
            speed_scale=0.956,
        ),
        "Fitted to a training in DeepRacer-for-Cloud of July 2022, version 4 in its "
        "model_metadata.json: slow to steer and to speed up.",
    ),
)

CAR_SETS: Mapping[str, CarSet] = MappingProxyType({each.name: each for each in _SETS})
"""The default first."""


def car_of(car: str | CarParameters) -> CarParameters:
    """Parameters, or those of a set by its name in any letter case.

    Raises:
        ValueError: There is no such set.
    """
    if isinstance(car, CarParameters):
        return car
    found = CAR_SETS.get(car.casefold()) if isinstance(car, str) else None
    if found is None:
        close = difflib.get_close_matches(str(car)[:100].casefold(), CAR_SETS, n=1)
        hint = f"Did you mean {close[0]}? " if close else ""
        raise ValueError(
            f"{car!r} is not a car. {hint}Choose one of {', '.join(CAR_SETS)}, or pass your own "
            "CarParameters."
        )
    return found.parameters
