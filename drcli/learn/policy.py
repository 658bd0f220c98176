"""Common to all policies: shape, input, and choice of actions."""

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
        num_actions: Length of a list, or continuous dimensions.
        continuous: A Gaussian over [-1, 1].
        network: `neural_network` of model_metadata.json.
        stack: Frames that are seen together.
        state_dims: For the critic only.
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
        return self.stack * self.eyes

    @property
    def noise_dims(self) -> int:
        """Random numbers per choice: a standard normal one for each continuous dimension.

        Else two in [0, 1): the action, and whether e-greedy acts at random.
        """
        return self.num_actions if self.continuous else 2


class Observation(NamedTuple):
    """The input of a network, for n steps.

    Attributes:
        frames: uint8, oldest first, left eye first. Shape (n, stack * eyes, 120, 160), or as in
            `encoders.in_blocks`.
        scan: Shape (n, d), d may be 0.
        state: For the critic only. Shape (n, k), k may be 0.
    """

    frames: Tensor
    scan: Tensor
    state: Tensor

    @staticmethod
    def of_arrays(frames: NDArray[np.uint8], scans: Float32s, states: Float32s) -> "Observation":
        """Tensors that share the arrays' memory."""
        return Observation(*(torch.from_numpy(array) for array in (frames, scans, states)))

    def part(self, steps: slice) -> "Observation":
        return Observation(*(column[steps] for column in self))


class Policy(Protocol):
    @property
    def spec(self) -> PolicySpec:
        """Its shape."""

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Choose an action for each of n cars.

        Args:
            seen: The input.
            noise: Shape (n, noise_dims).
            deterministic: Which cars take the most likely action. Shape (n,).
            epsilon: For e-greedy: share of uniform actions.

        Returns:
            Actions, log-probabilities, and estimates in reward, float64, of length n.
        """


@dataclass(frozen=True)
class Decision:
    """Actions of n cars, with what the learner needs.

    Attributes:
        actions: int64 indices of shape (n,), or unclipped float32 values of shape (n, dims).
        values: In reward.
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
    """Choose actions on the CPU, without gradients."""
    with torch.inference_mode():
        chosen = policy.act(seen, torch.from_numpy(noise), torch.from_numpy(deterministic), epsilon)
    return Decision(*(tensor.numpy() for tensor in chosen))
