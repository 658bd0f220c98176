import math

import numpy as np
import pytest
import torch

from drcli.learn import distributions

LOGITS = torch.tensor([[0.0, math.log(2.0), math.log(5.0)]])
"""Chances 1/8, 2/8, 5/8."""


@pytest.mark.parametrize(
    ("draw", "action"), [(0.0, 0), (0.124, 0), (0.126, 1), (0.374, 1), (0.376, 2), (0.99999, 2)]
)
def test_a_uniform_draw_picks_the_action_whose_share_it_falls_into(draw, action):
    got = distributions.sample_categorical(LOGITS, torch.tensor([draw]))

    assert got.tolist() == [action]


@pytest.mark.parametrize(
    ("noise", "action"), [([0.0, 0.29], 0), ([0.4, 0.29], 1), ([0.999, 0.0], 2), ([0.0, 0.31], 2)]
)
def test_a_blind_draw_takes_any_action_and_the_others_the_likeliest(noise, action):
    got = distributions.sample_e_greedy(LOGITS, torch.tensor([noise]), epsilon=0.3)

    assert got.tolist() == [action]


def test_log_prob_of_a_choice_is_the_log_of_its_share():
    got = distributions.log_prob_categorical(LOGITS, torch.tensor([2]))

    assert got.item() == pytest.approx(math.log(5 / 8))


def test_entropy_of_equal_chances_is_the_log_of_their_number():
    got = distributions.entropy_categorical(torch.zeros(4, 3))

    np.testing.assert_allclose(got.numpy(), math.log(3.0), rtol=1e-6)


def test_gaussian_log_prob_agrees_with_torch():
    mean, actions = torch.randn(5, 2), torch.randn(5, 2)
    log_std = torch.tensor([-0.5, 0.7])

    got = distributions.log_prob_gaussian(mean, log_std, actions)

    normal = torch.distributions.Normal(mean, log_std.exp())
    torch.testing.assert_close(got, normal.log_prob(actions).sum(-1))
    torch.testing.assert_close(
        distributions.entropy_gaussian(log_std), normal.entropy()[0].sum(), check_stride=False
    )
