"""The steps of many iterations, for SAC and for students of a teacher."""

from collections import deque
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation, PolicySpec
from drcli.learn.rollout_buffer import Rollout


class Transitions(NamedTuple):
    """A minibatch of n steps.

    Attributes:
        actions: In [-1, 1]. Shape (n, dims).
        returns: Discounted rewards up to `after`.
        after: Up to `n_step` steps later; meaningless where `discounts` is 0.
        discounts: Gamma to the power of the steps between, 0 if the rules ended the episode.
    """

    before: Observation
    actions: Tensor
    returns: Tensor
    after: Observation
    discounts: Tensor

    def part(self, steps: slice, device: torch.device) -> "Transitions":
        def part(column: Tensor) -> Tensor:
            return column[steps].to(device)

        before, actions, returns, after, discounts = self
        before, after = Observation(*map(part, before)), Observation(*map(part, after))
        return Transitions(before, part(actions), part(returns), after, part(discounts))


class ReplayBuffer:
    """A ring buffer of whole episodes in main memory; new episodes replace the oldest.

    A step takes little more than its frame, 19.2 kB. If the step limit cut an episode off, its
    last step is not learned from.
    """

    def __init__(
        self, spec: PolicySpec, capacity: int, discount_factor: float = 1.0, n_step: int = 1
    ) -> None:
        """Reserve all memory now, so that a lack of it shows at the start.

        Raises:
            RuntimeError: There is not enough memory.
        """
        self.capacity = capacity
        self._stack = spec.stack
        self._ahead = torch.arange(n_step)
        self._weights = discount_factor ** torch.arange(n_step + 1, dtype=torch.float64)
        self._frames = torch.empty(
            (capacity, spec.eyes, FRAME_HEIGHT, FRAME_WIDTH), dtype=torch.uint8
        )
        self._scans = torch.empty((capacity, spec.scan_dims))
        self._states = torch.empty((capacity, spec.state_dims))
        self._actions = torch.empty((capacity, spec.num_actions))
        self._rewards = torch.empty(capacity, dtype=torch.float64)
        self._left = torch.empty(capacity, dtype=torch.int64)
        self._rewarded = torch.empty(capacity, dtype=torch.int64)
        self._ages = torch.empty(capacity, dtype=torch.int64)
        self._usable = torch.zeros(capacity, dtype=torch.bool)
        self._usable_rows = torch.empty(0, dtype=torch.int64)
        self._lengths: deque[int] = deque()
        self._end = 0
        self.steps = 0

    @property
    def transitions(self) -> int:
        return len(self._usable_rows)

    def add(self, rollout: Rollout) -> None:
        """Add episodes in place of the oldest; of one that is too long, only the end."""
        ends = np.cumsum(rollout.lengths).tolist()
        episodes = zip(rollout.lengths.tolist(), ends, rollout.cut.tolist(), strict=True)
        for length, end, cut in episodes:
            self._add_episode(rollout, slice(end - min(length, self.capacity), end), cut)
        self._usable_rows = self._usable.nonzero().squeeze(-1)

    def _add_episode(self, rollout: Rollout, steps: slice, cut: bool) -> None:
        length = steps.stop - steps.start
        while self.steps + length > self.capacity:
            oldest = self._lengths.popleft()
            self._usable[self._ring(self._end - self.steps, oldest)] = False
            self.steps -= oldest
        rows = self._ring(self._end, length)
        columns = (
            (self._frames, rollout.frames),
            (self._scans, rollout.scans),
            (self._states, rollout.states),
            (self._actions, rollout.actions),
            (self._rewards, rollout.rewards),
        )
        until_end = min(length, self.capacity - self._end)
        for column, values in columns:
            new = torch.as_tensor(values[steps], dtype=column.dtype)
            # Slices are copied six times as fast as rows by their numbers.
            column[self._end : self._end + until_end] = new[:until_end]
            column[: length - until_end] = new[until_end:]
        # Steps of the episode after each step, and rewards from it on that a return may count: the
        # return of an episode that was cut off needs an observation after its rewards.
        self._left[rows] = torch.arange(length - 1, -1, -1)
        self._rewarded[rows] = self._left[rows] + (0 if cut else 1)
        for unknown in np.flatnonzero(~rollout.learned[steps]).tolist()[::-1]:
            # Returns count rewards up to there, where the observation is known but not the reward.
            ahead = torch.arange(unknown, -1, -1)
            before = rows[: unknown + 1]
            self._rewarded[before] = torch.minimum(self._rewarded[before], ahead)
        self._ages[rows] = torch.arange(length)
        self._usable[rows] = self._rewarded[rows] > 0
        self._lengths.append(length)
        self._end = (self._end + length) % self.capacity
        self.steps += length

    def _ring(self, start: int, length: int) -> Tensor:
        return (torch.arange(length) + start) % self.capacity

    def sample(self, count: int, draw: torch.Generator) -> Transitions:
        chosen = torch.randint(self.transitions, (count,), generator=draw)
        rows = self._usable_rows[chosen]
        steps = self._rewarded[rows].clamp(max=len(self._ahead))
        rewards = self._rewards[(rows[:, None] + self._ahead) % self.capacity]
        counted = self._weights[:-1] * (self._ahead < steps[:, None])
        # What lies beyond the episode may be anything, NaN as well, so it is not multiplied by 0.
        returns = torch.where(counted > 0.0, rewards * counted, 0.0).sum(1)
        goes_on = steps <= self._left[rows]
        after = (rows + steps * goes_on) % self.capacity
        discounts = (self._weights[steps] * goes_on).float()
        return Transitions(
            self._seen(rows), self._actions[rows], returns, self._seen(after), discounts
        )

    def sample_observed(
        self, count: int, draw: torch.Generator, newest: int
    ) -> tuple[Observation, Tensor]:
        ages = torch.rand(count, generator=draw)
        ages[::2] *= min(newest, self.steps) / self.steps
        rows = (self._end - 1 - (ages * self.steps).long()) % self.capacity
        return self._seen(rows), self._actions[rows]

    def _seen(self, rows: Tensor) -> Observation:
        back = torch.arange(self._stack - 1, -1, -1)
        stacked = (rows[:, None] - torch.minimum(back, self._ages[rows, None])) % self.capacity
        # index_select copies whole frames; indexing with two dimensions is several times slower.
        frames = self._frames.index_select(0, stacked.flatten())
        shape = (len(rows), -1, FRAME_HEIGHT, FRAME_WIDTH)
        return Observation(frames.view(shape), self._scans[rows], self._states[rows])
