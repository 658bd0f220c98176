"""Distributions of actions, discrete and Gaussian: sampling, log-probability and entropy."""

import math

import torch
from torch import Tensor

HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)


def sample_categorical(logits: Tensor, noise: Tensor) -> Tensor:
    """Draw action indices from logits of shape (n, num_actions).

    `noise`, uniform in [0, 1), of shape (n,), makes an episode repeatable.
    """
    cumulative = logits.softmax(-1).cumsum(-1)
    chosen = torch.searchsorted(cumulative, noise.unsqueeze(-1).to(cumulative.dtype), right=True)
    # Rounding can leave the last sum slightly below one, and a draw above it.
    return chosen.squeeze(-1).clamp_(max=logits.shape[-1] - 1)


def sample_e_greedy(logits: Tensor, noise: Tensor, epsilon: float) -> Tensor:
    """Draw action indices uniformly with probability epsilon, else take the most likely ones.

    `noise` is uniform in [0, 1), of shape (n, 2): the action, and whether it counts.
    """
    count = logits.shape[-1]
    uniform = (noise[:, 0] * count).long().clamp_(max=count - 1)
    return torch.where(noise[:, 1] < epsilon, uniform, logits.argmax(-1))


def sample_gaussian(mean: Tensor, log_std: Tensor, noise: Tensor) -> Tensor:
    """Draw unclipped values from standard normal `noise`, all of shape (n, dims)."""
    return mean + log_std.exp() * noise


def log_prob_categorical(logits: Tensor, actions: Tensor) -> Tensor:
    return logits.log_softmax(-1).gather(-1, actions.unsqueeze(-1)).squeeze(-1)


def log_prob_gaussian(mean: Tensor, log_std: Tensor, actions: Tensor) -> Tensor:
    """Log-density of values of shape (n, dims)."""
    scaled = (actions - mean) / log_std.exp()
    return (-0.5 * scaled.square() - log_std - HALF_LOG_2PI).sum(-1)


def entropy_categorical(logits: Tensor) -> Tensor:
    """Entropy of each step, nats. Shape (n,)."""
    log_p = logits.log_softmax(-1)
    return -(log_p.exp() * log_p).sum(-1)


def entropy_gaussian(log_std: Tensor) -> Tensor:
    """Entropy, nats: the same at every step."""
    return (log_std + 0.5 + HALF_LOG_2PI).sum()
