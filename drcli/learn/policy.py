"""Common to all policies: their shape, their input, and how they choose actions."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Float32s = NDArray[np.float32]
Float64s = NDArray[np.float64]

FRAME_HEIGHT, FRAME_WIDTH = 120, 160
"""Pixels of the grey camera picture. Source: the reference simulator's observation."""


@dataclass(frozen=True)
class PolicySpec:
    """Input, body and output of a network.

    Attributes:
        num_actions: Length of a discrete action list, or the number of continuous dimensions.
        continuous: Whether the policy is a Gaussian over [-1, 1] instead of a choice.
        network: `neural_network` of model_metadata.json.
        eyes: Cameras, 1 or 2.
        stack: Frames that are seen together.
        scan_dims: Values of the lidar, 0 without one.
        state_dims: Values that only the critic sees; 0 if it sees the same as the policy.
        taught: Whether it has a teacher, a policy that drives by the state alone.
    """

    num_actions: int
    continuous: bool = False
    network: str = "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
    eyes: int = 1
    stack: int = 1
    scan_dims: int = 0
    state_dims: int = 0
    taught: bool = False

    @property
    def channels(self) -> int:
        """Input channels of the first convolution."""
        return self.stack * self.eyes

    @property
    def noise_dims(self) -> int:
        """Random numbers that one choice takes.

        There is a standard normal one for each continuous dimension. For discrete actions there
        are two in [0, 1): one for the action, one for whether e-greedy acts at random.
        """
        return self.num_actions if self.continuous else 2


class Observation(NamedTuple):
    """The input of a network, for n steps.

    Attributes:
        frames: Camera frames, uint8; the oldest frame of a stack first, and in each the left eye
            before the right one. Shape (n, stack * eyes, 120, 160), or in the blocks of a network
            in bfloat16, see `encoders.in_blocks`.
        scan: Lidar values. Shape (n, d), d = 0 without a lidar.
        state: Values that only the critic sees. Shape (n, k), k = 0 if there are none.
    """

    frames: Tensor
    scan: Tensor
    state: Tensor

    @staticmethod
    def of_arrays(frames: NDArray[np.uint8], scans: Float32s, states: Float32s) -> "Observation":
        """The same as tensors, which share the arrays' memory."""
        return Observation(*(torch.from_numpy(array) for array in (frames, scans, states)))

    def part(self, steps: slice) -> "Observation":
        """Some of the steps."""
        return Observation(*(column[steps] for column in self))


class Policy(Protocol):
    """A network that can drive."""

    @property
    def spec(self) -> PolicySpec:
        """Its shape."""

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Choose an action for each of n cars.

        Args:
            seen: The input of each car.
            noise: Random numbers. Shape (n, noise_dims).
            deterministic: Which cars take the most likely action. Shape (n,).
            epsilon: For e-greedy: the share of actions drawn uniformly; the others are the most
                likely ones. None to draw from the policy.

        Returns:
            Actions, their log-probabilities, and the critic's estimates in reward, float64. Each
            of length n.
        """


@dataclass(frozen=True)
class Decision:
    """The actions of n cars, with what the learner needs to know about them.

    Attributes:
        actions: int64 indices of shape (n,), or unclipped float32 values of shape (n, dims).
        log_probs: Log-probability of each action. Shape (n,).
        values: The critic's estimate in reward. Shape (n,).
    """

    actions: NDArray[np.int64] | Float32s
    log_probs: Float32s
    values: Float64s


def decide(
    policy: Policy,
    seen: Observation,
    noise: Float32s,
    deterministic: NDArray[np.bool_],
    epsilon: float | None = None,
) -> Decision:
    """Choose an action for each car with `Policy.act` on the CPU, without gradients."""
    with torch.inference_mode():
        chosen = policy.act(seen, torch.from_numpy(noise), torch.from_numpy(deterministic), epsilon)
    return Decision(*(tensor.numpy() for tensor in chosen))
