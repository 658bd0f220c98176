import pytest
import torch

from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import Observation, PolicySpec

COMPACT = "COMPACT_CONVOLUTIONAL_NETWORK"
EVERYTHING = PolicySpec(
    3, continuous=True, network=COMPACT, eyes=2, stack=2, scan_dims=8, state_dims=5
)


@pytest.mark.parametrize("spec", [PolicySpec(5), EVERYTHING])
def test_gradients_equal_the_slope_of_the_loss_in_double_precision(spec):
    torch.manual_seed(0)
    model = ActorCritic(spec).double()
    seen = _random(spec, steps=1)
    _loss(model, seen).backward()

    for name, parameter in model.named_parameters():
        if name == "log_std":
            continue
        direction = torch.randn_like(parameter)
        expected = torch.sum(parameter.grad * direction).item()
        assert _slope(model, seen, parameter, direction) == pytest.approx(expected, rel=2e-3), name


def test_gradients_in_single_precision_agree_with_double_precision():
    torch.manual_seed(0)
    double = ActorCritic(PolicySpec(5)).double()
    single = ActorCritic(PolicySpec(5))
    single.load_state_dict(double.state_dict())
    seen = _random(PolicySpec(5), steps=2)

    for model in (single, double):
        _loss(model, seen).backward()

    for one, other in zip(single.parameters(), double.parameters(), strict=True):
        error = (one.grad.double() - other.grad).norm() / other.grad.norm()
        assert error < 1e-4


@pytest.mark.parametrize("spec", [PolicySpec(5, network=COMPACT), EVERYTHING])
def test_a_pass_gives_one_policy_row_and_one_value_for_each_step(spec):
    output = ActorCritic(spec)(_random(spec, steps=4))

    assert output.policy.shape == (4, spec.num_actions)
    assert output.value.shape == (4,)


def test_a_critic_that_sees_the_state_leaves_the_body_alone():
    model = ActorCritic(EVERYTHING)

    model(_random(EVERYTHING, steps=2)).value.sum().backward()

    assert all(p.grad is None for p in model.body.parameters())
    assert all(p.grad is not None for p in model.value_head.parameters())


def test_only_the_critic_sees_the_state():
    model = ActorCritic(EVERYTHING)
    seen = _random(EVERYTHING, steps=2)

    before, after = model(seen), model(seen._replace(state=seen.state + 1.0))

    assert torch.equal(before.policy, after.policy)
    assert not torch.equal(before.value, after.value)


def test_a_critic_without_a_state_of_its_own_trains_the_body():
    spec = PolicySpec(2, network=COMPACT)
    model = ActorCritic(spec)

    model(_random(spec, steps=2)).value.sum().backward()

    assert all(p.grad is not None for p in model.body.parameters())


def test_heads_start_with_nearly_equal_chances_and_a_value_of_unit_length():
    model = ActorCritic(PolicySpec(5, network=COMPACT))

    lengths = model.policy_head.weight.norm(dim=1), model.value_head.weight.norm(dim=1)

    torch.testing.assert_close(lengths[0], torch.full((5,), 0.01))
    torch.testing.assert_close(lengths[1], torch.ones(1))


def test_heads_compute_in_single_precision_while_the_body_runs_in_bfloat16():
    spec = PolicySpec(5, network=COMPACT)
    model = ActorCritic(spec)
    model.body.to(torch.bfloat16)
    seen = _random(spec, steps=2)

    features = model.body(seen)
    output = model(seen)

    assert features.dtype == torch.bfloat16
    assert output.policy.dtype == torch.float32
    assert torch.equal(output.policy, model.policy_head(features.float()))
    assert torch.equal(output.value, model.value_head(features.float()).squeeze(-1))


def _random(spec: PolicySpec, steps: int) -> Observation:
    torch.manual_seed(1)
    frames = torch.randint(0, 256, (steps, spec.channels, 120, 160), dtype=torch.uint8)
    return Observation(
        frames, torch.rand(steps, spec.scan_dims), torch.randn(steps, spec.state_dims)
    )


def _loss(model: ActorCritic, seen: Observation) -> torch.Tensor:
    """A number that depends on every output, in the model's precision."""
    kind = model.policy_head.weight.dtype
    policy, value = model(Observation(seen.frames, seen.scan.to(kind), seen.state.to(kind)))
    return policy.log_softmax(-1)[:, 0].sum() + (value - 1.0).square().sum()


def _slope(
    model: ActorCritic, seen: Observation, parameter: torch.Tensor, direction: torch.Tensor
) -> float:
    """Central difference of the loss along a direction, too short to meet the kink of a ReLU."""
    width = 1e-7 / direction.norm().item()
    losses = []
    with torch.no_grad():
        for side in (1.0, -1.0):
            parameter += side * width * direction
            losses.append(_loss(model, seen).item())
            parameter -= side * width * direction
    return (losses[0] - losses[1]) / (2.0 * width)
