"""A Gaussian squeezed into (-1, 1) by tanh: the policy of soft actor-critic."""

import math

import torch
from torch import Tensor
from torch.nn import functional

from drcli.learn.distributions import log_prob_gaussian


def squash(mean: Tensor, log_std: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Draw actions with the caller's random numbers.

    Args:
        mean: Of the Gaussian before tanh. Shape (n, dims).
        log_std: Log of its standard deviation. Shape (n, dims).
        noise: Standard normal; 0 gives the action at the mean. Shape (n, dims).

    Returns:
        Actions in [-1, 1], shape (n, dims), and their log-density, shape (n,). Both let the
        gradient through to mean and standard deviation.
    """
    raw = mean + log_std.exp() * noise
    # log(1 - tanh(x)^2) = 2 (log 2 - x - softplus(-2 x)), which does not round to log 0. Source:
    # TensorFlow Probability's Tanh bijector.
    log_slope = 2.0 * (math.log(2.0) - raw - functional.softplus(-2.0 * raw))
    return torch.tanh(raw), log_prob_gaussian(mean, log_std, raw) - log_slope.sum(-1)
