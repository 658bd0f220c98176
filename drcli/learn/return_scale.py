"""Scales returns by their running size, so that the critic can learn from rewards of any size.

The idea is PopArt's (van Hasselt et al., 2016, "Learning values across many orders of magnitude"):
targets are divided by a running size. When that changes, the last layer is rescaled, so that the
predictions stay the same. The mean is not subtracted: that gave no earlier lap over five seeds with
the shipped example (docs/benchmarks.md).
"""

import torch
from torch import Tensor, nn

FOLLOW = 0.3
"""Weight of one iteration in the running size: it follows returns that grow with the car's skill
within a few iterations, and no single iteration decides it."""

UNITS = 5.0
"""Mean size of the returns in the critic's own units. Of 3, 5 and 10 it needed the fewest steps to
the first evaluation lap with the shipped example (medians of five seeds, but single seeds differ
more than these medians: docs/benchmarks.md)."""


class ReturnScale(nn.Module):
    """How much reward one of the critic's own units is worth.

    Both numbers are stored with the weights, so a resumed training continues exactly. They
    and all sums of rewards have double precision. So rewards multiplied by a constant lead to the
    same single-precision numbers in the network, and to the same weights, byte for byte.

    Attributes:
        scale: Reward of one unit; 0 before the first returns, so that a fresh critic expects 0
            whatever the size of a reward. Scalar, float64.
        weight: Sum of the weights in the running mean, 0 to 1. Scalar, float64.
    """

    scale: Tensor
    weight: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("scale", torch.zeros((), dtype=torch.float64))
        self.register_buffer("weight", torch.zeros((), dtype=torch.float64))
        # The type is ignored because torch has no type for it.
        self.register_load_state_dict_pre_hook(_as_before)  # type: ignore[no-untyped-call]

    def forward(self, units: Tensor) -> Tensor:
        """From the critic's units to rewards, float64, in any shape."""
        return units.double() * self.scale

    def units(self, rewards: Tensor) -> Tensor:
        """From rewards, float64, to the critic's units, float32, in any shape."""
        return (rewards / torch.where(self.scale > 0.0, self.scale, 1.0)).float()

    @torch.no_grad()
    def follow(self, size: Tensor, *last: nn.Linear) -> None:
        """Update the scale, and rescale the critic so that its predictions stay the same.

        Args:
            size: Mean size of the iteration's returns, or of the critic's predictions if that is
                larger: if the scale fell faster than the critic can learn, the critic's outputs
                would grow without limit. Scalar, float64, finite.
            last: Last layers of the critics. They stay as they are if the critics have never
                learned.
        """
        before = self.scale.clone()
        self.weight.lerp_(torch.ones_like(self.weight), FOLLOW)
        self.scale.lerp_(size / UNITS, FOLLOW / self.weight)
        if before > 0.0 and self.scale > 0.0:
            for layer in last:
                layer.weight.mul_(before / self.scale)
                layer.bias.mul_(before / self.scale)


def _as_before(module: nn.Module, tensors: dict[str, Tensor], prefix: str, *_: object) -> None:
    """Read checkpoints of version 0.1.0, whose critics predict reward itself."""
    for name, value in (("scale", 1.0), ("weight", 0.0)):
        tensors.setdefault(f"{prefix}{name}", torch.tensor(value, dtype=torch.float64))
