"""Action spaces: from a policy's output to steering and speed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Floats


@dataclass(frozen=True)
class DiscreteActions:
    """A list of steering in degrees (left positive) and speed in m/s; the action is an index."""

    choices: Sequence[tuple[float, float]]

    def space(self) -> gym.Space[Any]:
        return gym.spaces.Discrete(len(self.choices))

    def requests(self, actions: NDArray[Any]) -> tuple[Floats, Floats]:
        """Degrees and m/s, each of shape (n,), for actions of shape (n,)."""
        table = np.asarray(self.choices, np.float64)[np.asarray(actions, np.int64)]
        return table[:, 0], table[:, 1]


@dataclass(frozen=True)
class ContinuousActions:
    """Ranges, left positive; the action is a pair of numbers, clipped to -1 .. 1.

    It is mapped linearly.
    """

    steering_deg: tuple[float, float] = (-30.0, 30.0)
    speed_mps: tuple[float, float] = (1.0, 4.0)

    def space(self) -> gym.Space[Any]:
        return gym.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def requests(self, actions: NDArray[Any]) -> tuple[Floats, Floats]:
        """As in `DiscreteActions`, for actions of shape (n, 2)."""
        low, high = np.array([self.steering_deg, self.speed_mps], np.float64).T
        mapped = low + (high - low) * (np.clip(np.asarray(actions, np.float64), -1, 1) + 1) / 2
        return mapped[:, 0], mapped[:, 1]


Actions = DiscreteActions | ContinuousActions

DEFAULT_ACTIONS = DiscreteActions(
    tuple((angle, speed) for angle in (-30.0, -15.0, 0.0, 15.0, 30.0) for speed in (1.0, 2.0))
)
