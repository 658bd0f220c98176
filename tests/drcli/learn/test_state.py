import torch

from drcli.learn.state import optimizer_tensors, restore_optimizer


def test_a_restored_optimizer_takes_the_same_next_step():
    first, second = _linear(), _linear()
    original = torch.optim.Adam(first.parameters(), lr=0.1, fused=True)
    _step(first, original)
    second.load_state_dict(first.state_dict())
    copy = torch.optim.Adam(second.parameters(), lr=0.1, fused=True)

    restore_optimizer(copy, optimizer_tensors(original))

    _step(first, original)
    _step(second, copy)
    assert torch.equal(first.weight, second.weight)


def test_an_optimizer_that_never_stepped_remembers_nothing():
    optimizer = torch.optim.Adam(_linear().parameters())

    assert optimizer_tensors(optimizer) == {}


def _linear() -> torch.nn.Linear:
    torch.manual_seed(0)
    return torch.nn.Linear(3, 2)


def _step(model: torch.nn.Linear, optimizer: torch.optim.Optimizer) -> None:
    optimizer.zero_grad()
    model(torch.tensor([1.0, 2.0, 3.0])).square().sum().backward()
    optimizer.step()
