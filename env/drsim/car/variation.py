"""How cars of one batch differ from each other."""

from typing import NamedTuple

import numpy as np

from drsim.arrays import Floats


class Variation(NamedTuple):
    """How n cars differ from their parameters; each of shape (n,).

    Attributes:
        friction: Factor on the grip of the wheels.
        mass: Factor on mass and inertia of every part.
        battery: Factor on wheel speed and torque.
        latency_s: Requests act this much later, seconds.
        steering_trim_deg: Wheels stand this much further to the left than requested.
        steering_left: Factor on angles to the left.
        steering_right: Factor on angles to the right.
    """

    friction: Floats
    mass: Floats
    battery: Floats
    latency_s: Floats
    steering_trim_deg: Floats
    steering_left: Floats
    steering_right: Floats


def no_variation(num_cars: int) -> Variation:
    """Cars as their parameters say."""
    factors = [np.ones(num_cars) for _ in range(7)]
    return Variation(*factors)._replace(
        latency_s=np.zeros(num_cars), steering_trim_deg=np.zeros(num_cars)
    )
