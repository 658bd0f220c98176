"""How cars of one batch differ from each other."""

from typing import NamedTuple

import numpy as np

from drsim.arrays import Floats


class Variation(NamedTuple):
    """How n cars differ from their parameters, as in `Conditions`; each of shape (n,)."""

    friction: Floats
    mass: Floats
    battery: Floats
    latency_s: Floats
    steering_trim_deg: Floats
    steering_left: Floats
    steering_right: Floats


def no_variation(num_cars: int) -> Variation:
    factors = [np.ones(num_cars) for _ in range(7)]
    return Variation(*factors)._replace(
        latency_s=np.zeros(num_cars), steering_trim_deg=np.zeros(num_cars)
    )
