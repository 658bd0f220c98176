"""How far ahead the discount factor lets a car plan."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from drcli.analysis.findings.driven_steps import STEP_S


@dataclass(frozen=True)
class DiscountHorizon:
    """The horizon 1 / (1 - discount factor)."""

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
