"""Chances of actions: sampling, log-probability, entropy and divergence, discrete and Gaussian."""

import math

import torch
from torch import Tensor

from drcli.learn.policy import ActorCritic

HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)


def sample(model: ActorCritic, policy: Tensor, noise: Tensor) -> Tensor:
    """Draw actions with the caller's random numbers, so that an episode can be repeated.

    Args:
        model: The network that produced `policy`.
        policy: Its policy output. Shape (n, num_actions).
        noise: Discrete: uniform in [0, 1), shape (n,). Continuous: standard normal, shape
            (n, num_actions).

    Returns:
        Discrete: int64 indices, shape (n,). Continuous: unclipped values, shape (n, num_actions).
    """
    if model.spec.continuous:
        return policy + model.log_std_bounded().exp() * noise
    cumulative = policy.softmax(-1).cumsum(-1)
    chosen = torch.searchsorted(cumulative, noise.unsqueeze(-1).to(cumulative.dtype), right=True)
    # Rounding can leave the last sum a hair below one, and a draw above it.
    return chosen.squeeze(-1).clamp_(max=model.spec.num_actions - 1)


def most_likely(model: ActorCritic, policy: Tensor) -> Tensor:
    """The deterministic action: argmax, or the mean of the Gaussian."""
    return policy if model.spec.continuous else policy.argmax(-1)


def log_prob(model: ActorCritic, policy: Tensor, actions: Tensor) -> Tensor:
    """Log-probability (density) of actions. Shape (n,)."""
    if model.spec.continuous:
        log_std = model.log_std_bounded()
        scaled = (actions - policy) / log_std.exp()
        return (-0.5 * scaled.square() - log_std - HALF_LOG_2PI).sum(-1)
    return policy.log_softmax(-1).gather(-1, actions.unsqueeze(-1)).squeeze(-1)


def entropy(model: ActorCritic, policy: Tensor) -> Tensor:
    """Entropy of the policy at each state, in nats. Shape (n,)."""
    if model.spec.continuous:
        one = (model.log_std_bounded() + 0.5 + HALF_LOG_2PI).sum()
        return one.expand(policy.shape[0])
    log_p = policy.log_softmax(-1)
    return -(log_p.exp() * log_p).sum(-1)
