import math

import numpy as np
import pytest
import torch
from torch.distributions import Independent, Normal, TransformedDistribution
from torch.distributions.transforms import TanhTransform

from drcli.learn.sac_networks import squash


def test_log_probs_are_those_of_a_normal_distribution_transformed_by_tanh():
    draw = torch.Generator().manual_seed(0)
    mean, log_std, noise = torch.randn((3, 50, 2), generator=draw, dtype=torch.float64)
    squashed = TransformedDistribution(
        Independent(Normal(mean, log_std.exp()), 1), TanhTransform(cache_size=1)
    )

    actions, log_probs = squash(mean, log_std, noise)

    raw = mean + log_std.exp() * noise
    np.testing.assert_allclose(actions, raw.tanh())
    np.testing.assert_allclose(log_probs, squashed.log_prob(squashed.transforms[0](raw)))


def test_the_log_prob_in_the_middle_of_a_standard_normal_is_worked_by_hand():
    # There tanh has slope 1, so that what is left is the Gaussian: -log sqrt(2 pi) a dimension.
    zero = torch.zeros(1, 2)

    actions, log_probs = squash(zero, zero, zero)

    assert actions.tolist() == [[0.0, 0.0]]
    assert log_probs.item() == pytest.approx(-math.log(2.0 * math.pi))


def test_actions_at_the_border_have_finite_log_probs_and_gradients():
    mean = torch.tensor([[30.0, -30.0]], requires_grad=True)
    log_std = torch.zeros(1, 2, requires_grad=True)

    actions, log_probs = squash(mean, log_std, torch.zeros(1, 2))
    log_probs.sum().backward()

    assert actions.tolist() == [[1.0, -1.0]]
    assert torch.isfinite(log_probs).all()
    assert torch.isfinite(mean.grad).all()
    assert torch.isfinite(log_std.grad).all()
