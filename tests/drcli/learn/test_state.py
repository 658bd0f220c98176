import pytest
import torch
from safetensors.torch import load, save

from drcli.learn.state import optimizer_tensors, restore_optimizer


@pytest.mark.parametrize("kind", ["linear", "convolution"])
def test_a_restored_optimizer_takes_the_same_next_step(kind):
    first, second = _layer(kind), _layer(kind)
    original = torch.optim.Adam(first.parameters(), lr=0.1, fused=True)
    _step(first, original)
    second.load_state_dict(first.state_dict())
    copy = torch.optim.Adam(second.parameters(), lr=0.1, fused=True)

    restore_optimizer(copy, load(save(optimizer_tensors(original))))

    _step(first, original)
    _step(second, copy)
    assert torch.equal(first.weight, second.weight)


def test_an_optimizer_that_never_stepped_remembers_nothing():
    optimizer = torch.optim.Adam(_layer("linear").parameters())

    assert optimizer_tensors(optimizer) == {}


@pytest.mark.parametrize("kind", ["linear", "convolution"])
def test_the_fused_optimizer_takes_the_steps_of_the_paper(kind):
    """Kingma and Ba, 2015, algorithm 1, worked in double precision."""
    layer = _layer(kind)
    optimizer = torch.optim.Adam(layer.parameters(), lr=0.01, eps=1e-5, fused=True)
    weight = layer.weight.detach().double()
    first, second = torch.zeros_like(weight), torch.zeros_like(weight)

    for step in (1, 2, 3):
        _step(layer, optimizer)
        gradient = layer.weight.grad.double()
        first = 0.9 * first + 0.1 * gradient
        second = 0.999 * second + 0.001 * gradient**2
        mean, spread = first / (1 - 0.9**step), second / (1 - 0.999**step)
        weight -= 0.01 * mean / (spread.sqrt() + 1e-5)

    torch.testing.assert_close(layer.weight.detach().double(), weight, rtol=1e-5, atol=1e-6)


def _layer(kind: str) -> torch.nn.Module:
    torch.manual_seed(0)
    if kind == "linear":
        return torch.nn.Linear(18, 2)
    layer = torch.nn.Conv2d(2, 4, 3)
    # As the networks lay out their convolutions.
    layer.weight.data = layer.weight.data.contiguous(memory_format=torch.channels_last)
    return layer


def _step(model: torch.nn.Module, optimizer: torch.optim.Optimizer) -> None:
    optimizer.zero_grad()
    shape = (1, 18) if isinstance(model, torch.nn.Linear) else (1, 2, 3, 3)
    model(torch.arange(18.0).reshape(shape) / 9.0).square().sum().backward()
    optimizer.step()
