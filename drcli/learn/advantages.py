"""Advantages: how much better than expected each step of a rollout went."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from drcli.learn.policy import Float64s

ROUNDING = 1e-9
"""Relative difference below which advantages count as equal."""


def gae(
    rewards: Float64s,
    values: Float64s,
    lengths: NDArray[np.int64],
    gamma: float,
    lam: float,
    last_values: Float64s | None = None,
    learned: NDArray[np.bool_] | None = None,
) -> Float64s:
    """Generalized advantage estimation (Schulman et al., 2016, equation 16).

    Args:
        rewards: Of several episodes, one after the other. Shape (t,).
        values: The critic's estimate before each step. Shape (t,).
        lengths: Steps of each episode. Shape (e,).
        gamma: Discount factor.
        lam: 0 trusts the critic, 1 the rewards.
        last_values: The value after each episode. Shape (e,). None: 0, for completed laps too, as
            hyperparameters of the reference expect.
        learned: Where the reward is known. Elsewhere the advantage is 0, and `values` stands for
            the rest. Shape (t,).

    Returns:
        A(t) = delta(t) + gamma * lam * A(t + 1), with
        delta(t) = r(t) + gamma * V(t + 1) - V(t). Shape (t,).
    """
    advantages = np.empty(len(rewards))
    end = len(rewards)
    after = np.zeros(len(lengths)) if last_values is None else last_values
    known = [True] * end if learned is None else learned.tolist()
    for length, last_value in zip(lengths[::-1].tolist(), after[::-1].tolist(), strict=True):
        next_value, next_advantage = last_value, 0.0
        for t in range(end - 1, end - length - 1, -1):
            value = float(values[t])
            if not known[t]:
                next_value, next_advantage, advantages[t] = value, 0.0, 0.0
                continue
            delta = float(rewards[t]) + gamma * next_value - value
            next_advantage = delta + gamma * lam * next_advantage
            advantages[t] = next_advantage
            next_value = value
        end -= length
    return advantages


def normalized(advantages: Float64s) -> Float64s:
    """Advantages with mean 0 and deviation 1; all 0 if they differ by rounding errors only.

    No constant is added to the deviation: it would count more for small rewards.
    """
    centered = advantages - advantages.mean()
    std = centered.std()
    if std <= ROUNDING * np.abs(advantages).max():
        return np.zeros_like(advantages)
    scaled: Float64s = centered / std
    return scaled


def explained_variance(values: Float64s, returns: Float64s) -> float:
    """Share of the returns' variance that the critic explains; NaN if there is none.

    1 is perfect, 0 as good as the mean, less than 0 worse.
    """
    variance = float(np.var(returns))
    return 1.0 - float(np.var(returns - values)) / variance if variance > 0.0 else float("nan")


# Scales returns by their running size, so that the critic can learn from rewards of any size.
#
# PopArt's idea (van Hasselt et al., 2016, "Learning values across many orders of magnitude"): the
# last layer is rescaled with it. Subtracting the mean gave no earlier lap over five seeds
# (docs/benchmarks.md).


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
