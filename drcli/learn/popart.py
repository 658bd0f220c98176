"""Mean and scale of the returns, so that the critic learns numbers of one size from any reward.

PopArt (van Hasselt et al., 2016, "Learning values across many orders of magnitude").
"""

import torch
from torch import Tensor, nn

FOLLOW = 0.3
"""Weight of one iteration in the running mean and variance. One outlier then moves the scale by
half of what it would alone, and returns that grow with the car's skill never lie further than
1.6 standard deviations from the mean."""

ROUNDING = 1e-6
"""Differences of less than this share of the values are rounding errors of single precision."""


class ReturnScale(nn.Module):
    """What a return of the critic's own units is worth in units of the reward.

    The three numbers are buffers: they are stored with the weights, and a resumed training goes on
    with them exactly.

    Attributes:
        mean: Running mean of the returns. Scalar.
        std: Running standard deviation; 0 before the first returns, so that a fresh critic expects
            0 whatever a reward's size. Scalar.
        weight: Sum of the weights that mean and deviation consist of, 0 to 1. Scalar.
    """

    mean: Tensor
    std: Tensor
    weight: Tensor

    def __init__(self) -> None:
        super().__init__()
        for name in ("mean", "std", "weight"):
            self.register_buffer(name, torch.zeros(()))
        self.register_load_state_dict_pre_hook(_as_before)  # type: ignore[no-untyped-call]

    def forward(self, normalized: Tensor) -> Tensor:
        """From the critic's units to those of the reward, in any shape."""
        return self.mean + self.std * normalized

    def normalize(self, returns: Tensor) -> Tensor:
        """From units of the reward to the critic's, in any shape."""
        return (returns - self.mean) / torch.where(self.std > 0.0, self.std, 1.0)

    @torch.no_grad()
    def follow(self, returns: Tensor, last: nn.Linear) -> None:
        """Take in the returns of an iteration, and keep what the critic says as it is.

        Args:
            returns: Targets of the critic, all finite. Shape (n,).
            last: The critic's last layer, which is changed so that the same values come out. That
                of a critic that has never learned is left alone.
        """
        exact = returns.double()
        center, variance = exact.mean(), exact.var(correction=0)
        before, spread = self.mean.double(), self.std.double()
        total = (1.0 - FOLLOW) * self.weight.double() + FOLLOW
        share = FOLLOW / total
        mean = before + share * (center - before)
        # The variance of a mixture: differences of means count, and nothing large cancels out.
        mixed = (1.0 - share) * (spread**2 + (before - mean) ** 2)
        std = (mixed + share * (variance + (center - mean) ** 2)).sqrt()
        # Where all returns are the same their own size is the scale.
        std = torch.where(std > ROUNDING * mean.abs(), std, mean.abs())
        if spread > 0.0 and std > 0.0:
            last.weight.mul_(spread / std)
            last.bias.copy_((spread * last.bias.double() + before - mean) / std)
        self.mean.copy_(mean)
        self.std.copy_(std)
        self.weight.copy_(total)


def _as_before(module: nn.Module, tensors: dict[str, Tensor], prefix: str, *_: object) -> None:
    """Read checkpoints of version 0.1.0, whose critics speak in units of the reward."""
    for name, value in (("mean", 0.0), ("std", 1.0), ("weight", 0.0)):
        tensors.setdefault(f"{prefix}{name}", torch.tensor(value))
