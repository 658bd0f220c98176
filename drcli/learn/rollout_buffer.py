"""The rollout of one iteration: as arrays, and as tensors for an update."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from drcli.learn.cuda import ReusedMemory
from drcli.learn.encoders import in_blocks
from drcli.learn.policy import Float32s, Float64s, Observation

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Rollout:
    """Whole episodes one after the other, t steps in e episodes.

    Attributes:
        frames: uint8, shape (t, eyes, 120, 160).
        actions: int64 indices of shape (t,), or unclipped float32 values of shape (t, dims).
        values: In reward.
        lengths: Of episodes. Shape (e,).
        last_values: Of the rest where the step limit cut off. Shape (e,).
        cut: By the step limit. Shape (e,).
        scans: Shape (t, d).
        states: For the critic only. Shape (t, k).
        learned: Steps whose reward is known; elsewhere the critic's estimate stands for the rest.
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
    learned: NDArray[np.bool_] = field(default_factory=lambda: np.ones(0, np.bool_))

    def __post_init__(self) -> None:
        if not len(self.learned):
            object.__setattr__(self, "learned", np.ones(len(self.rewards), np.bool_))

    @property
    def steps(self) -> int:
        return len(self.rewards)

    def of_episodes(self, chosen: Sequence[int]) -> "Rollout":
        """Some of the episodes, by number."""
        ends = np.cumsum(self.lengths)
        rows = [np.arange(ends[k] - self.lengths[k], ends[k]) for k in chosen]
        steps = np.concatenate([np.empty(0, np.int64), *rows])
        episodes = np.asarray(chosen, np.int64)
        return Rollout(
            frames=self.frames[steps],
            actions=self.actions[steps],
            log_probs=self.log_probs[steps],
            values=self.values[steps],
            rewards=self.rewards[steps],
            lengths=self.lengths[episodes],
            last_values=self.last_values[episodes],
            cut=self.cut[episodes],
            scans=self.scans[steps],
            states=self.states[steps],
            learned=self.learned[steps],
        )

    def following_rows(self) -> Ints:
        """The next step's row; at the end of an episode the last. Shape (t,)."""
        following = np.arange(self.steps) + 1
        following[np.cumsum(self.lengths) - 1] -= 1
        return following

    def stacked_rows(self, stack: int) -> Ints:
        """Rows of the frames seen together, oldest first, the first repeated. Shape (t, stack)."""
        begins = np.cumsum(self.lengths) - self.lengths
        rows = np.arange(self.steps)
        ages = rows - np.repeat(begins, self.lengths)
        return rows[:, None] - np.minimum(np.arange(stack - 1, -1, -1), ages[:, None])


@dataclass(frozen=True)
class RolloutTensors:
    """A rollout with normalised advantages, as tensors on the learner's device.

    Frames stay in main memory if a GPU's is too small. On a GPU, columns may have more rows.
    `values` and `returns` are in the critic's units.
    """

    frames: Tensor
    frame_rows: Tensor
    following: Tensor
    scans: Tensor
    states: Tensor
    actions: Tensor
    log_probs: Tensor
    values: Tensor
    advantages: Tensor
    returns: Tensor

    @staticmethod
    def of(
        rollout: Rollout,
        stack: int,
        block: int,
        *,
        values: Tensor,
        advantages: Float64s,
        returns: Tensor,
        memory: ReusedMemory | None = None,
    ) -> "RolloutTensors":
        def place(name: str, column: Tensor) -> Tensor:
            return column.to(returns.device) if memory is None else memory.place(name, column)

        def tensor(name: str, column: NDArray[Any]) -> Tensor:
            return place(name, torch.from_numpy(np.ascontiguousarray(column)))

        frames = torch.from_numpy(np.ascontiguousarray(rollout.frames))
        cut = partial(in_blocks, size=block)  # once, and not for each epoch
        try:
            if memory is not None and block > 1:
                frames = memory.place("frames", frames, cut)
            else:
                frames = place("frames", cut(frames) if block > 1 else frames)
        except torch.OutOfMemoryError:
            frames = cut(frames) if block > 1 else frames
        return RolloutTensors(
            frames=frames,
            frame_rows=tensor("frame_rows", rollout.stacked_rows(stack)),
            following=tensor("following", rollout.following_rows()),
            scans=tensor("scans", rollout.scans),
            states=tensor("states", rollout.states),
            actions=tensor("actions", rollout.actions),
            log_probs=tensor("log_probs", rollout.log_probs),
            values=place("values", values),
            advantages=tensor("advantages", advantages.astype(np.float32)),
            returns=place("returns", returns),
        )

    def observation(self, rows: Tensor) -> Observation:
        # index_select copies whole frames; indexing with two dimensions is several times slower.
        seen = self.frame_rows[rows].flatten().to(self.frames.device)
        frames = self.frames.index_select(0, seen).to(self.scans.device)
        channels = self.frame_rows.shape[1] * self.frames.shape[1]
        frames = frames.view(len(rows), channels, *self.frames.shape[2:])
        return Observation(frames, self.scans[rows], self.states[rows])
