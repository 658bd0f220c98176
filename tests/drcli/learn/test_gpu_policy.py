"""A policy on a GPU chooses what the same policy in main memory chooses."""

import numpy as np
import pytest
import torch

from drcli.learn.actor_critic import ActorCritic
from drcli.learn.cuda import POLICY_ROWS, GpuPolicy
from drcli.learn.policy import Observation, PolicySpec, decide
from drcli.learn.sac_networks import SACAgent

CPU = torch.device("cpu")
CARS = 5


@pytest.mark.parametrize("epsilon", [None, 0.5])
def test_it_chooses_what_the_policy_itself_chooses_for_any_number_of_cars(epsilon):
    policy = _policy(PolicySpec(4, network="COMPACT_CONVOLUTIONAL_NETWORK"))
    on_gpu = GpuPolicy(policy, CPU)
    on_gpu.follow(torch.float32)

    for cars in (4, 2, 1, CARS, 3):
        seen, noise, most_likely = _drive(cars, 2)
        own = decide(policy, seen, noise, most_likely, epsilon)
        other = decide(on_gpu, seen, noise, most_likely, epsilon)

        np.testing.assert_array_equal(other.actions, own.actions)
        np.testing.assert_allclose(other.log_probs, own.log_probs, rtol=1e-5)
        np.testing.assert_allclose(other.values, own.values, rtol=1e-5)


def test_a_car_chooses_the_same_bits_beside_any_number_of_cars():
    on_gpu = GpuPolicy(_policy(PolicySpec(4, network="COMPACT_CONVOLUTIONAL_NETWORK")), CPU)
    on_gpu.follow(torch.float32)
    seen, noise, most_likely = _drive(POLICY_ROWS + CARS, 2)

    whole = decide(on_gpu, seen, noise, most_likely)
    for cars in (slice(0, 1), slice(CARS, 2 * CARS), slice(CARS, POLICY_ROWS + CARS)):
        part = decide(on_gpu, seen.part(cars), noise[cars], most_likely[cars])

        for own, other in zip(vars(part).values(), vars(whole).values(), strict=True):
            np.testing.assert_array_equal(own, other[cars])


@pytest.mark.parametrize("network", [ActorCritic, SACAgent])
def test_continuous_actions_keep_their_numbers(network):
    torch.manual_seed(0)
    policy = network(PolicySpec(2, continuous=True, network="COMPACT_CONVOLUTIONAL_NETWORK"))
    on_gpu = GpuPolicy(policy, CPU)
    on_gpu.follow(torch.float32)
    seen, noise, most_likely = _drive(3, 2)

    own = decide(policy, seen, noise, most_likely)
    other = decide(on_gpu, seen, noise, most_likely)

    assert other.actions.dtype == np.float32
    np.testing.assert_allclose(other.actions, own.actions, rtol=1e-5)


def test_it_follows_the_weights_and_the_number_format():
    policy = _policy(PolicySpec(4, network="COMPACT_CONVOLUTIONAL_NETWORK"))
    on_gpu = GpuPolicy(policy, CPU)
    seen, noise, most_likely = _drive(3, 2)
    on_gpu.follow(torch.float32)
    before = decide(on_gpu, seen, noise, most_likely).log_probs

    with torch.no_grad():
        policy.policy_head.bias += torch.tensor([3.0, 0.0, 0.0, 0.0])
    on_gpu.follow(torch.bfloat16)
    after = decide(on_gpu, seen, noise, most_likely).log_probs

    assert np.abs(after - before).max() > 0.5
    assert policy.body.convolutions[0].weight.dtype is torch.float32
    np.testing.assert_allclose(after, decide(policy, seen, noise, most_likely).log_probs, atol=0.05)


def _policy(spec):
    torch.manual_seed(0)
    return ActorCritic(spec)


def _drive(cars, noise_dims):
    draw = np.random.default_rng(cars)
    frames = draw.integers(0, 256, (cars, 1, 120, 160), dtype=np.uint8)
    nothing = np.empty((cars, 0), np.float32)
    noise = draw.random((cars, noise_dims), dtype=np.float32)
    return Observation.of_arrays(frames, nothing, nothing), noise, np.arange(cars) % 2 == 0
