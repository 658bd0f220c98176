"""What soft actor-critic learns from: the steps of many iterations, each frame stored once."""

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
        before: What was seen when the action was chosen.
        actions: Values in [-1, 1]. Shape (n, dims).
        rewards: Shape (n,).
        after: What was seen one step later; without meaning where nothing goes on.
        goes_on: 1, or 0 where the episode ended by its rules with this step. Shape (n,).
    """

    before: Observation
    actions: Tensor
    rewards: Tensor
    after: Observation
    goes_on: Tensor

    def part(self, steps: slice) -> "Transitions":
        """Some of the steps."""
        return Transitions(
            self.before.part(steps),
            self.actions[steps],
            self.rewards[steps],
            self.after.part(steps),
            self.goes_on[steps],
        )

    def to(self, device: torch.device) -> "Transitions":
        """The same on another device."""
        return Transitions(
            Observation(*(column.to(device) for column in self.before)),
            self.actions.to(device),
            self.rewards.to(device),
            Observation(*(column.to(device) for column in self.after)),
            self.goes_on.to(device),
        )


class ReplayBuffer:
    """A ring of whole episodes, in main memory; the oldest make room for new ones.

    A step takes little more than its frame, 19.2 kB: what was seen after a step is what was seen
    before the next one. Nothing was seen after the last step of an episode. Where the episode
    ended by its rules this does not matter, since no reward follows; where the step limit cut it
    off, that one step is not learned from.

    All memory is reserved at once, so that too little of it shows at the start. The operating
    system hands it out when it is first written to.

    Attributes:
        capacity: Steps that fit.
        steps: Steps in it.
        taken_in: Steps that were ever added.
    """

    def __init__(self, spec: PolicySpec, capacity: int) -> None:
        """Reserve the memory.

        Args:
            spec: What is perceived, and how many dimensions an action has.
            capacity: Steps that fit.

        Raises:
            RuntimeError: There is not so much memory.
        """
        self.capacity = capacity
        self._stack = spec.stack
        self._frames = torch.empty(
            (capacity, spec.eyes, FRAME_HEIGHT, FRAME_WIDTH), dtype=torch.uint8
        )
        self._scans = torch.empty((capacity, spec.scan_dims))
        self._states = torch.empty((capacity, spec.state_dims))
        self._actions = torch.empty((capacity, spec.num_actions))
        self._rewards = torch.empty(capacity)
        self._goes_on = torch.empty(capacity)
        self._ages = torch.empty(capacity, dtype=torch.int64)
        self._usable = torch.zeros(capacity, dtype=torch.bool)
        self._usable_rows = torch.empty(0, dtype=torch.int64)
        self._lengths: deque[int] = deque()
        self._end = 0
        self.steps = 0
        self.taken_in = 0

    @property
    def transitions(self) -> int:
        """Steps that can be drawn."""
        return len(self._usable_rows)

    @property
    def reserved_bytes(self) -> int:
        """Memory that a full replay takes."""
        columns = (
            self._frames,
            self._scans,
            self._states,
            self._actions,
            self._rewards,
            self._goes_on,
            self._ages,
            self._usable,
            # The list of usable rows, once all are.
            self._ages,
        )
        return sum(column.nbytes for column in columns)

    def add(self, rollout: Rollout) -> None:
        """Take in the episodes of an iteration, and forget the oldest that do not fit beside them.

        Of an episode that is longer than the whole replay the end is kept.
        """
        ends = np.cumsum(rollout.lengths).tolist()
        episodes = zip(rollout.lengths.tolist(), ends, rollout.cut.tolist(), strict=True)
        for length, end, cut in episodes:
            self._add_episode(rollout, slice(end - min(length, self.capacity), end), cut)
        self._usable_rows = self._usable.nonzero().squeeze(-1)
        self.taken_in += rollout.steps

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
        for column, values in columns:
            column[rows] = torch.as_tensor(values[steps], dtype=column.dtype)
        self._goes_on[rows] = 1.0
        self._goes_on[rows[-1]] = 0.0
        self._ages[rows] = torch.arange(length)
        self._usable[rows] = True
        self._usable[rows[-1]] = not cut
        self._lengths.append(length)
        self._end = (self._end + length) % self.capacity
        self.steps += length

    def _ring(self, start: int, length: int) -> Tensor:
        return (torch.arange(length) + start) % self.capacity

    def sample(self, count: int, draw: torch.Generator) -> Transitions:
        """Draw steps, all with the same chance, again and again the same one if it so happens.

        Args:
            count: How many.
            draw: Source of random numbers, on the CPU.
        """
        chosen = torch.randint(self.transitions, (count,), generator=draw)
        rows = self._usable_rows[chosen]
        goes_on = self._goes_on[rows]
        after = (rows + goes_on.long()) % self.capacity
        return Transitions(
            self._seen(rows), self._actions[rows], self._rewards[rows], self._seen(after), goes_on
        )

    def _seen(self, rows: Tensor) -> Observation:
        """What was seen at some steps; before an episode's beginning its first frame repeats."""
        back = torch.arange(self._stack - 1, -1, -1)
        stacked = (rows[:, None] - torch.minimum(back, self._ages[rows, None])) % self.capacity
        # index_select copies whole frames; indexing with two dimensions is several times slower.
        frames = self._frames.index_select(0, stacked.flatten())
        shape = (len(rows), -1, FRAME_HEIGHT, FRAME_WIDTH)
        return Observation(frames.view(shape), self._scans[rows], self._states[rows])
