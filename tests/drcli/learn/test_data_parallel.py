import pytest
import torch
from torch import nn

from drcli.learn.data_parallel import Crew, parts_of

SAMPLES = 7
INPUT = torch.linspace(-1.0, 1.0, SAMPLES * 3).view(SAMPLES, 3)


def test_parts_leave_the_gradient_of_the_whole_and_the_mean_of_the_figures():
    whole, divided = _network(), _network()

    figures = Crew(whole).step(_loss, SAMPLES, _nothing)
    shared = Crew(divided, parts=3, threads=3).step(_loss, SAMPLES, _nothing)

    torch.testing.assert_close(shared, figures)
    for one, other in zip(whole.parameters(), divided.parameters(), strict=True):
        torch.testing.assert_close(other.grad, one.grad)


def test_gradients_of_the_step_before_do_not_count():
    network = _network()
    crew = Crew(network, parts=2, threads=2)

    crew.step(_loss, SAMPLES, _nothing)
    once = network[0].weight.grad.clone()
    crew.step(_loss, SAMPLES, _nothing)

    assert torch.equal(network[0].weight.grad, once)


def test_all_parts_see_new_weights_at_once():
    network, fresh = _network(), _network()
    crew = Crew(network, parts=2, threads=2)
    optimizer = torch.optim.SGD(network.parameters(), lr=0.1)
    crew.step(_loss, SAMPLES, optimizer.step)
    fresh.load_state_dict(network.state_dict())

    crew.step(_loss, SAMPLES, _nothing)
    Crew(fresh).step(_loss, SAMPLES, _nothing)

    torch.testing.assert_close(network[0].weight.grad, fresh[0].weight.grad)


def test_what_no_sample_needs_has_no_gradient():
    network = _network().append(nn.Linear(1, 1))

    Crew(network, parts=2, threads=2).step(_loss, SAMPLES, _nothing)

    assert network[2].weight.grad is None


def test_fewer_samples_than_parts_are_one_part():
    seen = []

    def loss_of(model, part):
        seen.append(part)
        return _loss(model, part)

    Crew(_network(), parts=4, threads=4).step(loss_of, 3, _nothing)

    assert seen == [slice(0, 3)]


def test_the_error_of_a_part_is_the_error_of_the_whole():
    def loss_of(model, part):
        if part.start > 0:
            raise ArithmeticError("broken")
        return _loss(model, part)

    with pytest.raises(ArithmeticError, match="broken"):
        Crew(_network(), parts=2, threads=2).step(loss_of, SAMPLES, _nothing)


def test_the_threads_of_the_caller_stay_as_they_are():
    before = torch.get_num_threads()
    inside = []

    def loss_of(model, part):
        inside.append(torch.get_num_threads())
        return _loss(model, part)

    Crew(_network(), parts=2, threads=2).step(loss_of, SAMPLES, _nothing)

    assert inside == [1, 1]
    assert torch.get_num_threads() == before


@pytest.mark.parametrize(
    ("batch_size", "threads", "parts"), [(64, 1, 1), (64, 2, 2), (64, 16, 4), (31, 2, 1), (8, 4, 1)]
)
def test_parts_are_not_too_small(batch_size, threads, parts):
    assert parts_of(batch_size, threads) == parts


def _nothing() -> None:
    """For tests that look at the gradient itself."""


def _network() -> nn.Sequential:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(3, 4), nn.Linear(4, 2))


def _loss(model, part):
    out = model[1](model[0](INPUT[part]))
    loss = out.square().mean()
    return loss, torch.stack([loss, out.mean()])
