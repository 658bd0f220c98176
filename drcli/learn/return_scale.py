"""Scales returns by their running size, so that the critic can learn from rewards of any size.

PopArt's idea (van Hasselt et al., 2016, "Learning values across many orders of magnitude"): the
last layer is rescaled with it. Subtracting the mean gave no earlier lap over five seeds
(docs/benchmarks.md).
"""

import torch
from torch import Tensor, nn

FOLLOW = 0.3
"""Weight of one iteration."""

UNITS = 5.0
"""Mean size of the returns. Of 3, 5 and 10 it needed the fewest steps to a lap (medians of five
seeds, which differ more: docs/benchmarks.md).
"""


class ReturnScale(nn.Module):
    """How much reward one of the critic's own units is worth; stored with the weights.

    In double precision, so multiplied rewards lead to the same weights, byte for byte.
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
        return units.double() * self.scale

    def units(self, rewards: Tensor) -> Tensor:
        return (rewards / torch.where(self.scale > 0.0, self.scale, 1.0)).float()

    @torch.no_grad()
    def follow(self, size: Tensor, *last: nn.Linear) -> None:
        """Update the scale, and rescale the critic so that its predictions stay the same.

        `size` is the mean of the returns, or of larger predictions: if the scale fell faster than
        the critic can learn, its outputs would grow without limit.
        """
        before = self.scale.clone()
        self.weight.lerp_(torch.ones_like(self.weight), FOLLOW)
        self.scale.lerp_(size / UNITS, FOLLOW / self.weight)
        if before > 0.0 and self.scale > 0.0:
            for layer in last:
                layer.weight.mul_(before / self.scale)
                layer.bias.mul_(before / self.scale)


def _as_before(module: nn.Module, tensors: dict[str, Tensor], prefix: str, *_: object) -> None:
    """For version 0.1.0, whose critics predict reward itself."""
    for name, value in (("scale", 1.0), ("weight", 0.0)):
        tensors.setdefault(f"{prefix}{name}", torch.tensor(value, dtype=torch.float64))
