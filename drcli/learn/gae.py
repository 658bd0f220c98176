"""Generalized advantage estimation (Schulman et al., 2016, equation 16)."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def gae(
    rewards: Floats,
    values: Floats,
    lengths: NDArray[np.int64],
    gamma: float,
    lam: float,
    last_values: Floats | None = None,
) -> Floats:
    """Advantages of every step of several episodes laid end to end.

    Args:
        rewards: Shape (t,).
        values: The critic's estimate before each step. Shape (t,).
        lengths: Steps of each episode, summing to t. Shape (episodes,).
        gamma: Discount factor.
        lam: Weight of longer returns: 0 trusts the critic, 1 the rewards.
        last_values: The value after each episode's last step. 0 when left out, for laps completed
            as well as for failures and cuts: this is the reference's rule, and hyperparameters
            tuned there depend on it. Shape (episodes,).

    Returns:
        A(t) = delta(t) + gamma * lam * A(t + 1), with
        delta(t) = r(t) + gamma * V(t + 1) - V(t). Shape (t,).
    """
    advantages = np.empty(len(rewards))
    end = len(rewards)
    after = np.zeros(len(lengths)) if last_values is None else last_values
    for length, last_value in zip(lengths[::-1].tolist(), after[::-1].tolist(), strict=True):
        next_value, next_advantage = last_value, 0.0
        for t in range(end - 1, end - length - 1, -1):
            value = float(values[t])
            delta = float(rewards[t]) + gamma * next_value - value
            next_advantage = delta + gamma * lam * next_advantage
            advantages[t] = next_advantage
            next_value = value
        end -= length
    return advantages
