"""What distinguishes one network from another."""

from dataclasses import dataclass

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
        state_dims: Values that only the critic sees; 0 where it sees what the policy sees.
    """

    num_actions: int
    continuous: bool = False
    network: str = "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
    eyes: int = 1
    stack: int = 1
    scan_dims: int = 0
    state_dims: int = 0

    @property
    def channels(self) -> int:
        """Pictures that go into the first convolution."""
        return self.stack * self.eyes
