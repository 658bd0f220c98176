"""What one iteration of driving leaves for the learner."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Rollout:
    """Whole episodes laid end to end, t steps in all.

    Attributes:
        frames: What the car saw before each step, uint8. Shape (t, 120, 160).
        actions: int64 indices of shape (t,), or unclipped float32 values of shape (t, dims).
        log_probs: Log-probability of each action when it was taken. Shape (t,).
        values: The critic's estimate when the action was taken. Shape (t,).
        rewards: Shape (t,).
        lengths: Steps of each episode, summing to t. Shape (episodes,).
    """

    frames: NDArray[np.uint8]
    actions: NDArray[np.int64] | NDArray[np.float32]
    log_probs: NDArray[np.float32]
    values: NDArray[np.float32]
    rewards: NDArray[np.float32]
    lengths: NDArray[np.int64]

    @property
    def steps(self) -> int:
        """Number of steps in all episodes."""
        return len(self.rewards)
