import numpy as np
import pytest
import torch

from drcli.learn.actor_critic import ActorCritic
from drcli.learn.data_parallel import FEWEST_CARS, DataParallelPolicy
from drcli.learn.policy import PolicySpec, decide
from observations import camera_only

SPECS = [PolicySpec(5), PolicySpec(2, continuous=True)]


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("cars", [1, 2 * FEWEST_CARS, 2 * FEWEST_CARS + 3, 33])
def test_parts_choose_bit_by_bit_what_the_whole_chooses(spec, cars):
    torch.manual_seed(0)
    policy = ActorCritic(spec).eval()
    random = np.random.default_rng(0)
    seen = camera_only(torch.randint(0, 255, (cars, 1, 120, 160), dtype=torch.uint8))
    noise = random.random((cars, policy.spec.noise_dims), dtype=np.float32)
    deterministic = np.arange(cars) % 2 == 0

    whole = decide(policy, seen, noise, deterministic)
    parts = decide(DataParallelPolicy(policy, threads=2), seen, noise, deterministic)

    for own, other in zip(vars(parts).values(), vars(whole).values(), strict=True):
        np.testing.assert_array_equal(own, other)


def test_new_weights_are_driven_with_at_once():
    policy = ActorCritic(PolicySpec(2, continuous=True)).eval()
    beside = DataParallelPolicy(policy, threads=2)
    cars = 2 * FEWEST_CARS
    seen = camera_only(torch.zeros((cars, 1, 120, 160), dtype=torch.uint8))
    likeliest = (np.zeros((cars, 2), np.float32), np.ones(cars, np.bool_))
    decide(beside, seen, *likeliest)

    with torch.no_grad():
        policy.policy_head.bias.fill_(0.25)

    np.testing.assert_allclose(decide(beside, seen, *likeliest).actions, 0.25)
