"""How far ahead the discount factor lets a car plan, beside the length of a lap."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from drcli.analysis.findings.driven_steps import STEP_S


@dataclass(frozen=True)
class DiscountHorizon:
    """The horizon 1 / (1 - discount factor).

    Attributes:
        discount: The discount factor.
        steps: The horizon in steps; infinite for a factor of 1.
        seconds: In simulated seconds.
        metres: At the present mean speed; None if the speed is unknown.
        lap_steps: Steps of a lap at the present speed; None if unknown.
        lap_m: Length of the lap; None if unknown.
        lap_share: The horizon as a share of the lap; None if unknown.
    """

    discount: float
    steps: float
    seconds: float
    metres: float | None
    lap_steps: float | None
    lap_m: float | None
    lap_share: float | None


def discount_horizon(
    hyperparameters: Mapping[str, object], length_m: float, speed_mps: float | None
) -> DiscountHorizon | None:
    """The horizon of a training; None if the discount factor is missing or no number.

    Args:
        hyperparameters: Of the training.
        length_m: Length of the track; NaN if unknown.
        speed_mps: Speed over the track late in the training.
    """
    value = hyperparameters.get("discount_factor")
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        return None
    steps = 1.0 / (1.0 - value) if value < 1.0 else math.inf
    lap_m = length_m if math.isfinite(length_m) and length_m > 0 else None
    step_m = speed_mps * STEP_S if speed_mps and math.isfinite(speed_mps) else None
    lap_steps = lap_m / step_m if lap_m and step_m else None
    return DiscountHorizon(
        discount=float(value),
        steps=steps,
        seconds=steps * STEP_S,
        metres=steps * step_m if step_m else None,
        lap_steps=lap_steps,
        lap_m=lap_m,
        lap_share=steps / lap_steps if lap_steps else None,
    )
