import math

import numpy as np
import pytest
import torch

from drcli.learn import distributions
from drcli.learn.policy import ActorCritic, PolicySpec

LOGITS = torch.tensor([[0.0, math.log(2.0), math.log(5.0)]])
"""Chances 1/8, 2/8, 5/8."""


@pytest.fixture(scope="module")
def discrete() -> ActorCritic:
    return ActorCritic(PolicySpec(3))


@pytest.fixture(scope="module")
def continuous() -> ActorCritic:
    return ActorCritic(PolicySpec(2, continuous=True))


@pytest.mark.parametrize(
    ("draw", "action"), [(0.0, 0), (0.124, 0), (0.126, 1), (0.374, 1), (0.376, 2), (0.99999, 2)]
)
def test_a_uniform_draw_picks_the_action_whose_share_it_falls_into(discrete, draw, action):
    got = distributions.sample(discrete, LOGITS, torch.tensor([draw]))

    assert got.tolist() == [action]


def test_log_prob_of_a_choice_is_the_log_of_its_share(discrete):
    got = distributions.log_prob(discrete, LOGITS, torch.tensor([2]))

    assert got.item() == pytest.approx(math.log(5 / 8))


def test_entropy_of_equal_chances_is_the_log_of_their_number(discrete):
    got = distributions.entropy(discrete, torch.zeros(4, 3))

    np.testing.assert_allclose(got.numpy(), math.log(3.0), rtol=1e-6)


def test_gaussian_log_prob_agrees_with_torch(continuous):
    mean, actions = torch.randn(5, 2), torch.randn(5, 2)
    with torch.no_grad():
        continuous.log_std.copy_(torch.tensor([-0.5, 0.7]))

    got = distributions.log_prob(continuous, mean, actions)

    normal = torch.distributions.Normal(mean, torch.tensor([-0.5, 0.7]).exp())
    torch.testing.assert_close(got, normal.log_prob(actions).sum(-1))
    torch.testing.assert_close(
        distributions.entropy(continuous, mean), normal.entropy().sum(-1), check_stride=False
    )


def test_the_most_likely_action_is_argmax_or_mean(discrete, continuous):
    mean = torch.tensor([[0.3, -2.0]])

    assert distributions.most_likely(discrete, LOGITS).tolist() == [2]
    torch.testing.assert_close(distributions.most_likely(continuous, mean), mean)
