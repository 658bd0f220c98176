"""Car parameters by name: the cars that models of other years have learned."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from drsim.car.car_parameters import CarParameters


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
