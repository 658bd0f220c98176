import subprocess
import sys

import pytest
import torch
from safetensors.torch import load, save

from drcli.learn.adam import Adam

LEARNING = """
import sys
import torch
from drcli.learn.adam import Adam

layer = torch.nn.Linear(3, 1)
layer(torch.ones(1, 3)).sum().backward()
Adam(layer.parameters(), lr=0.1).step()
print("torch._dynamo" in sys.modules)
"""


@pytest.mark.parametrize("kind", ["linear", "convolution"])
def test_a_restored_optimizer_takes_the_same_next_step(kind):
    first, second = _layer(kind), _layer(kind)
    original = Adam(first.parameters(), lr=0.1)
    _step(first, original)
    second.load_state_dict(first.state_dict())
    copy = Adam(second.parameters(), lr=0.1)

    copy.restore(load(save(original.tensors())))

    _step(first, original)
    _step(second, copy)
    assert torch.equal(first.weight, second.weight)


@pytest.mark.parametrize(
    ("stored", "said"),
    [
        ({"0.exp_avg": torch.zeros(1, 1)}, r"0\.exp_avg .* \(1, 1\), .* \(2, 18\)"),
        ({"0.step": torch.zeros(1)}, r"0\.step .* \(1,\), .* \(\)"),
        ({"2.step": torch.zeros(())}, "2.step"),
        ({"-1.step": torch.zeros(())}, "-1.step"),
        ({"0.max_exp_avg_sq": torch.zeros(2, 18)}, "0.max_exp_avg_sq"),
        ({"step": torch.zeros(())}, "step"),
    ],
)
def test_a_memory_over_other_parameters_is_refused_and_changes_nothing(stored, said):
    optimizer = Adam(_layer("linear").parameters(), lr=0.1)

    with pytest.raises(ValueError, match=said):
        optimizer.restore({"1.step": torch.ones(()), **stored})

    assert optimizer.tensors() == {}


def test_an_optimizer_that_never_stepped_remembers_nothing():
    optimizer = Adam(_layer("linear").parameters(), lr=0.1)

    assert optimizer.tensors() == {}


@pytest.mark.parametrize("kind", ["linear", "convolution"])
def test_it_takes_the_steps_of_the_paper(kind):
    """Kingma and Ba, 2015, algorithm 1, worked in double precision."""
    layer = _layer(kind)
    optimizer = Adam(layer.parameters(), lr=0.01, eps=1e-5)
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


@pytest.mark.parametrize("kind", ["linear", "convolution"])
def test_it_steps_and_remembers_as_pytorchs_own_class(kind):
    ours, theirs = _layer(kind), _layer(kind)
    optimizer = Adam(ours.parameters(), lr=0.01, eps=1e-5)
    peer = torch.optim.Adam(theirs.parameters(), lr=0.01, eps=1e-5, fused=True)

    for lr in (0.01, 0.02):
        optimizer.lr = peer.param_groups[0]["lr"] = lr
        _step(ours, optimizer)
        _step(theirs, peer)

    assert torch.equal(ours.weight, theirs.weight)
    state = peer.state_dict()["state"]
    remembered = {f"{i}.{name}" for i, memory in state.items() for name in memory}
    assert set(optimizer.tensors()) == remembered
    assert torch.equal(optimizer.tensors()["0.exp_avg_sq"], state[0]["exp_avg_sq"])


def test_a_parameter_without_a_gradient_keeps_its_value():
    layer = _layer("linear")
    optimizer = Adam(layer.parameters(), lr=0.1)
    before = layer.bias.detach().clone()
    layer.bias.requires_grad_(False)

    _step(layer, optimizer)

    assert torch.equal(layer.bias, before)
    assert "1.step" not in optimizer.tensors()


def test_learning_does_not_load_pytorchs_compiler():
    printed = subprocess.check_output([sys.executable, "-c", LEARNING], text=True)

    assert printed.strip() == "False"


def _layer(kind: str) -> torch.nn.Module:
    torch.manual_seed(0)
    if kind == "linear":
        return torch.nn.Linear(18, 2)
    layer = torch.nn.Conv2d(2, 4, 3)
    # As the networks lay out their convolutions.
    layer.weight.data = layer.weight.data.contiguous(memory_format=torch.channels_last)
    return layer


def _step(model: torch.nn.Module, optimizer: Adam | torch.optim.Adam) -> None:
    model.zero_grad()
    shape = (1, 18) if isinstance(model, torch.nn.Linear) else (1, 2, 3, 3)
    model(torch.arange(18.0).reshape(shape) / 9.0).square().sum().backward()
    optimizer.step()
