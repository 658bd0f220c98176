"""What one iteration of driving gives the learner: as arrays, and as tensors of an update."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from drcli.learn.policy import Observation

Float32s = NDArray[np.float32]
Float64s = NDArray[np.float64]
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
        last_values: The critic's estimate where the step limit cut an episode off; 0 where an
            episode ended by its rules. Shape (e,).
        cut: Which episodes the step limit cut off. Shape (e,).
        scans: Lidar values. Shape (t, d), d = 0 without a lidar.
        states: What only the critic may see. Shape (t, k), k = 0 where it sees nothing more.
    """

    frames: NDArray[np.uint8]
    actions: Ints | Float32s
    log_probs: Float32s
    values: Float64s
    rewards: Float64s
    lengths: Ints
    last_values: Float64s
    cut: NDArray[np.bool_]
    scans: Float32s
    states: Float32s

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


@dataclass(frozen=True)
class RolloutTensors:
    """A rollout with its advantages, as tensors on the learner's device.

    Each has a row for each of t steps, as in `Rollout`.

    Attributes:
        frames: Each frame once.
        frame_rows: Rows of the frames that are seen together at each step. Shape (t, stack).
        scans: Lidar values.
        states: What only the critic may see.
        actions: What was done.
        log_probs: Log-probability of each action when it was taken.
        values: The critic's estimate when the action was taken, in its own units.
        advantages: How much better than expected each step went, normalised, float32.
        returns: What the critic should say, in its own units.
    """

    frames: Tensor
    frame_rows: Tensor
    scans: Tensor
    states: Tensor
    actions: Tensor
    log_probs: Tensor
    values: Tensor
    advantages: Tensor
    returns: Tensor

    @staticmethod
    def of(
        rollout: Rollout, stack: int, values: Tensor, advantages: Float64s, returns: Tensor
    ) -> "RolloutTensors":
        """Put a rollout beside what an update computed from it, on the device of the latter."""

        def tensor(column: NDArray[Any]) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(column)).to(returns.device)

        return RolloutTensors(
            frames=tensor(rollout.frames),
            frame_rows=tensor(rollout.stacked_rows(stack)),
            scans=tensor(rollout.scans),
            states=tensor(rollout.states),
            actions=tensor(rollout.actions),
            log_probs=tensor(rollout.log_probs),
            values=values,
            advantages=tensor(advantages.astype(np.float32)),
            returns=returns,
        )

    def observation(self, rows: Tensor) -> Observation:
        """What was seen at some steps."""
        # index_select copies whole frames; indexing with two dimensions is several times slower.
        frames = self.frames.index_select(0, self.frame_rows[rows].flatten())
        frames = frames.view(len(rows), -1, *self.frames.shape[2:])
        return Observation(frames, self.scans[rows], self.states[rows])
