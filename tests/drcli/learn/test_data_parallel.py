"""The gradient of a minibatch in parts equals that of the whole, whatever the parts do."""

import copy

import pytest
import torch
from torch import nn

from drcli.learn.actor_critic import ActorCritic
from drcli.learn.data_parallel import DataParallel, parts_of
from drcli.learn.policy import Observation, PolicySpec

SAMPLES = 7
INPUT = torch.linspace(-1.0, 1.0, SAMPLES * 3).view(SAMPLES, 3)


def test_parts_leave_the_gradient_of_the_whole_and_the_mean_of_the_statistics():
    whole, divided = _network(), _network()

    statistics = DataParallel(whole).backward(_loss, SAMPLES)
    shared = DataParallel(divided, parts=3, threads=3).backward(_loss, SAMPLES)

    torch.testing.assert_close(shared, statistics)
    for one, other in zip(whole.parameters(), divided.parameters(), strict=True):
        torch.testing.assert_close(other.grad, one.grad)


def test_gradients_add_up_until_they_are_set_to_zero():
    network = _network()
    parallel = DataParallel(network, parts=2, threads=2)

    parallel.backward(_loss, SAMPLES)
    once = network[0].weight.grad.clone()
    parallel.backward(_loss, SAMPLES)
    twice = network[0].weight.grad.clone()
    network.zero_grad()
    parallel.backward(_loss, SAMPLES)

    torch.testing.assert_close(twice, 2 * once)
    assert torch.equal(network[0].weight.grad, once)


@pytest.mark.parametrize("parts", [1, 2])
def test_a_gpu_that_is_too_small_takes_smaller_parts_with_the_same_result(parts):  # 001-08
    whole, short = _network(), _network()
    sizes = []

    def loss_of(model, part):
        sizes.append(part.stop - part.start)
        if sizes[-1] > 2:
            raise torch.OutOfMemoryError("CUDA out of memory.")
        return _loss(model, part)

    parallel = DataParallel(short, parts, threads=parts)
    expected = DataParallel(whole).backward(_loss, SAMPLES) + DataParallel(whole).backward(
        _loss, SAMPLES
    )
    statistics = parallel.backward(loss_of, SAMPLES)
    tried = len(sizes)
    statistics = statistics + parallel.backward(loss_of, SAMPLES)  # adds up, also when repeated

    assert parallel.most_samples in (1, 2)
    assert max(sizes[tried:]) <= 2, "it remembers what fits"
    torch.testing.assert_close(statistics, expected)
    for one, other in zip(whole.parameters(), short.parameters(), strict=True):
        torch.testing.assert_close(other.grad, one.grad)


def test_a_gpu_without_room_for_one_sample_is_said():
    def loss_of(model, part):
        raise torch.OutOfMemoryError("CUDA out of memory.")

    with pytest.raises(torch.OutOfMemoryError):
        DataParallel(_network()).backward(loss_of, SAMPLES)


def test_the_gradients_of_a_step_that_failed_do_not_count():
    network = _network()
    parallel = DataParallel(network, parts=2, threads=2)
    parallel.backward(_loss, SAMPLES)
    once = network[0].weight.grad.clone()

    def fail_in_the_first_part(model, part):
        if part.start == 0:
            raise ArithmeticError
        return _loss(model, part)

    network.zero_grad()
    with pytest.raises(ArithmeticError):
        parallel.backward(fail_in_the_first_part, SAMPLES)
    parallel.backward(_loss, SAMPLES)

    assert torch.equal(network[0].weight.grad, once)


def test_all_parts_see_new_weights_at_once():
    network, fresh = _network(), _network()
    parallel = DataParallel(network, parts=2, threads=2)
    optimizer = torch.optim.SGD(network.parameters(), lr=0.1)
    parallel.backward(_loss, SAMPLES)
    optimizer.step()
    optimizer.zero_grad()
    fresh.load_state_dict(network.state_dict())

    parallel.backward(_loss, SAMPLES)
    DataParallel(fresh).backward(_loss, SAMPLES)

    torch.testing.assert_close(network[0].weight.grad, fresh[0].weight.grad)


@pytest.mark.parametrize("parts", [1, 2])
def test_bodies_in_bfloat16_give_nearly_the_same_gradient_to_the_same_weights(parts):
    torch.manual_seed(1)
    exact = ActorCritic(PolicySpec(3, network="COMPACT_CONVOLUTIONAL_NETWORK"))
    rounded = copy.deepcopy(exact)
    frames = torch.randint(0, 256, (4, 1, 120, 160), dtype=torch.uint8)
    nothing = torch.zeros(4, 0)

    def loss_of(model, part):
        policy, value = model(Observation(frames[part], nothing[part], nothing[part]))
        loss = (policy.square().mean(-1) + value.square()).mean()
        return loss, loss[None]

    parallel = DataParallel(rounded, parts, threads=parts, bf16=True)
    for _ in range(2):  # weights that have changed meanwhile are those that count
        for model in (exact, rounded):
            model.zero_grad()
        expected = DataParallel(exact).backward(loss_of, 4)
        found = parallel.backward(loss_of, 4)
        torch.testing.assert_close(found, expected, rtol=0.1, atol=0.0)
        for one, other in zip(exact.parameters(), rounded.parameters(), strict=True):
            assert other.dtype == other.grad.dtype == torch.float32
            assert other.grad.stride() == other.stride()
            near = torch.nn.functional.cosine_similarity(
                other.grad.flatten(), one.grad.flatten(), dim=0
            )
            assert near > 0.99
        with torch.no_grad():
            for one, other in zip(exact.parameters(), rounded.parameters(), strict=True):
                assert torch.equal(one, other)
                one.mul_(1.5)
                other.mul_(1.5)


def test_what_no_sample_needs_has_no_gradient():
    network = _network().append(nn.Linear(1, 1))

    DataParallel(network, parts=2, threads=2).backward(_loss, SAMPLES)

    assert network[2].weight.grad is None


def test_fewer_samples_than_parts_are_one_part():
    seen = []

    def loss_of(model, part):
        seen.append(part)
        return _loss(model, part)

    DataParallel(_network(), parts=4, threads=4).backward(loss_of, 3)

    assert seen == [slice(0, 3)]


def test_the_error_of_a_part_is_the_error_of_the_whole():
    def loss_of(model, part):
        if part.start > 0:
            raise ArithmeticError("broken")
        return _loss(model, part)

    with pytest.raises(ArithmeticError, match="broken"):
        DataParallel(_network(), parts=2, threads=2).backward(loss_of, SAMPLES)


def test_the_optimizer_of_a_small_network_has_the_threads_of_one_part():
    before = torch.get_num_threads()
    parallel = DataParallel(_network(), parts=2, threads=2)

    with parallel.optimizer_threads():
        inside = torch.get_num_threads()

    assert inside == 1
    assert torch.get_num_threads() == before


def test_the_threads_of_the_caller_stay_as_they_are():
    before = torch.get_num_threads()
    inside = []

    def loss_of(model, part):
        inside.append(torch.get_num_threads())
        return _loss(model, part)

    DataParallel(_network(), parts=2, threads=2).backward(loss_of, SAMPLES)

    assert inside == [1, 1]
    assert torch.get_num_threads() == before


@pytest.mark.parametrize(
    ("batch_size", "threads", "parts"), [(64, 1, 1), (64, 2, 2), (64, 16, 4), (31, 2, 1), (8, 4, 1)]
)
def test_parts_are_not_too_small(batch_size, threads, parts):
    assert parts_of(batch_size, threads) == parts


def _network() -> nn.Sequential:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(3, 4), nn.Linear(4, 2))


def _loss(model, part):
    out = model[1](model[0](INPUT[part]))
    loss = out.square().mean()
    return loss, torch.stack([loss, out.mean()])
