"""What one iteration of driving leaves for the learner."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Doubles = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Rollout:
    """Whole episodes laid end to end, t steps in e episodes.

    What counts in reward is of double precision; see `ReturnScale`.

    Attributes:
        frames: What the car saw before each step, each frame once, uint8.
            Shape (t, eyes, 120, 160).
        actions: int64 indices of shape (t,), or unclipped float32 values of shape (t, dims).
        log_probs: Log-probability of each action when it was taken. Shape (t,).
        values: The critic's estimate when the action was taken. Shape (t,).
        rewards: Shape (t,).
        lengths: Steps of each episode, summing to t. Shape (e,).
        last_values: What was still to be expected when an episode was cut off by the step limit;
            0 for one that ended by its rules. Shape (e,).
        cut: Which episodes the step limit cut off. Shape (e,).
        scans: What the lidar told. Shape (t, d), d = 0 without one.
        states: What only the critic may know. Shape (t, k), k = 0 where it knows nothing more.
    """

    frames: NDArray[np.uint8]
    actions: Ints | Singles
    log_probs: Singles
    values: Doubles
    rewards: Doubles
    lengths: Ints
    last_values: Doubles
    cut: NDArray[np.bool_]
    scans: Singles
    states: Singles

    @property
    def steps(self) -> int:
        """Number of steps in all episodes."""
        return len(self.rewards)

    @cached_property
    def ages(self) -> Ints:
        """How many steps of its episode lie before each step. Shape (t,)."""
        begins = np.cumsum(self.lengths) - self.lengths
        return np.arange(self.steps) - np.repeat(begins, self.lengths)

    def stacked_rows(self, stack: int) -> Ints:
        """Rows of the frames that are seen together at each step, oldest first.

        Before the beginning of an episode its first frame repeats.

        Args:
            stack: How many frames are seen together.

        Returns:
            Shape (t, stack).
        """
        back = np.arange(stack - 1, -1, -1)
        return np.arange(self.steps)[:, None] - np.minimum(back, self.ages[:, None])
