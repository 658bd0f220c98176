"""The network: what the car sees in, what it should do and what that is worth out."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

FRAME_HEIGHT, FRAME_WIDTH = 120, 160
"""Pixels of the grey camera picture. Source: the reference simulator's observation."""

LOG_STD_RANGE = (-20.0, 3.0)
"""Bounds of the Gaussian policy's log standard deviation. Source: the reference's PPO head."""


@dataclass(frozen=True)
class PolicySpec:
    """What distinguishes one network from another.

    Attributes:
        num_actions: Length of a discrete action list, or the number of continuous dimensions.
        continuous: Whether the policy is a Gaussian over [-1, 1] instead of a choice.
        network: DeepRacer's name of the body.
    """

    num_actions: int
    continuous: bool = False
    network: str = "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"


class Output(NamedTuple):
    """One forward pass.

    Attributes:
        policy: Logits of the actions, or the mean of the Gaussian. Shape (n, num_actions).
        value: Expected discounted return. Shape (n,).
    """

    policy: Tensor
    value: Tensor


class ShallowBody(nn.Module):
    """DeepRacer's DEEP_CONVOLUTIONAL_NETWORK_SHALLOW: three convolutions and 512 features.

    Valid padding, ReLU after every layer, Glorot-uniform kernels and zero biases as in the
    reference; features are flattened with channels last, which is also TensorFlow's order.
    """

    features = 512

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(1, 32, kernel_size=8, stride=4)
        self.conv2 = nn.Conv2d(32, 64, kernel_size=4, stride=2)
        self.conv3 = nn.Conv2d(64, 64, kernel_size=3, stride=1)
        self.dense = nn.Linear(11 * 16 * 64, self.features)
        for name, parameter in self.named_parameters():
            if name.endswith("weight"):
                nn.init.xavier_uniform_(parameter)
            else:
                nn.init.zeros_(parameter)

    def forward(self, frames: Tensor) -> Tensor:
        """Turn grey pictures into features.

        Args:
            frames: uint8 pictures. Shape (n, 120, 160).

        Returns:
            Shape (n, 512).
        """
        # Scaling the 2,048 kernel weights instead of every pixel saves a pass over the batch.
        # The one channel goes last in memory too: what is laid out so decides for all layers.
        pixels = frames.unsqueeze(-1).permute(0, 3, 1, 2).to(self.conv1.weight.dtype)
        x = functional.conv2d(pixels, self.conv1.weight / 255.0, self.conv1.bias, stride=4)
        x = functional.relu(x, inplace=True)
        x = functional.relu(self.conv2(x), inplace=True)
        x = functional.relu(self.conv3(x), inplace=True)
        flat = x.permute(0, 2, 3, 1).flatten(1)
        return functional.relu(self.dense(flat), inplace=True)


BODIES = {"DEEP_CONVOLUTIONAL_NETWORK_SHALLOW": ShallowBody}
"""Bodies by the name that `neural_network` in model_metadata.json gives them."""


class ActorCritic(nn.Module):
    """Policy and value on one shared body.

    The reference trains two whole bodies, one for the policy and one for the value. Sharing one
    halves the arithmetic and leaves the exported policy as it is.
    """

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__()
        self.spec = spec
        self.body = BODIES[spec.network]()
        self.policy_head = nn.Linear(self.body.features, spec.num_actions)
        self.value_head = nn.Linear(self.body.features, 1)
        nn.init.zeros_(self.policy_head.bias)
        nn.init.zeros_(self.value_head.bias)
        _init_columns(self.value_head.weight, 1.0)
        if spec.continuous:
            _init_columns(self.policy_head.weight, 0.01)
            self.log_std = nn.Parameter(torch.zeros(spec.num_actions))
        else:
            # Nearly equal chances at the start: every action gets tried from the first episode.
            _init_columns(self.policy_head.weight, 0.01)
        # oneDNN trains these convolutions two to four times faster with channels last.
        for parameter in self.parameters():
            if parameter.dim() == 4:
                parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)

    def forward(self, frames: Tensor) -> Output:
        """Evaluate policy and value.

        Args:
            frames: uint8 pictures. Shape (n, 120, 160).
        """
        features = self.body(frames).float()
        return Output(self.policy_head(features), self.value_head(features).squeeze(-1))

    def log_std_bounded(self) -> Tensor:
        """Log standard deviation of the Gaussian policy. Shape (num_actions,)."""
        return self.log_std.clamp(*LOG_STD_RANGE)


def _init_columns(weight: Tensor, std: float) -> None:
    """Draw a kernel whose rows each have the given Euclidean length."""
    with torch.no_grad():
        weight.normal_()
        weight.mul_(std / weight.square().sum(dim=1, keepdim=True).sqrt())
