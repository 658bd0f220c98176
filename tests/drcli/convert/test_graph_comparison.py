"""A graph is compared with its network; one that computes something else is found."""

import numpy as np
import pytest
import torch

from drcli.base.errors import SettingsError
from drcli.convert.build_network import weights_of
from drcli.convert.frozen_graph import compare_graph, compare_outputs, encode_policy
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import PolicySpec
from drcli.learn.sac_networks import SACAgent
from observations import camera_only

SENSORS = ("FRONT_FACING_CAMERA",)
FRAMES = torch.randint(
    0, 256, (40, 1, 120, 160), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
)


@pytest.mark.parametrize("kind", ["discrete", "continuous", "sac"])
def test_the_graph_of_a_network_is_equal_to_it(kind):
    model, spec = made(kind)
    graph = encode_policy(weights_of(model), spec, SENSORS)

    found = compare_graph(graph, model, camera_only(FRAMES), "the graph")

    assert (found.frames, found.same_actions) == (40, 40)
    assert found.greatest_difference < 1e-5
    assert found.is_equal


def test_the_graph_of_other_weights_is_not_equal():
    model, spec = made("discrete")
    other, _ = made("discrete", seed=2)
    graph = encode_policy(weights_of(other), spec, SENSORS)

    found = compare_graph(graph, model, camera_only(FRAMES), "the graph")

    assert not found.is_equal
    assert found.greatest_difference > 1e-3


def test_a_graph_with_another_number_of_outputs_is_refused():
    model, _ = made("discrete")
    other = ActorCritic(PolicySpec(4, network=model.spec.network)).eval()
    graph = encode_policy(weights_of(other), other.spec, SENSORS)

    with pytest.raises(SettingsError, match="The graph has 4 outputs, but its network has 3"):
        compare_graph(graph, model, camera_only(FRAMES[:1]), "The graph")


def test_actions_of_equal_probability_may_change_places():
    expected = np.array([[0.5, 0.5 - 1e-7], [0.7, 0.3]], np.float32)
    found = np.array([[0.5 - 1e-7, 0.5], [0.3, 0.7]], np.float32)

    result = compare_outputs(expected, found, continuous=False)

    assert (result.frames, result.same_actions) == (2, 1)
    assert result.greatest_difference == pytest.approx(0.4)


def test_continuous_actions_are_compared_as_the_car_clips_them():
    expected = np.array([[1.5, 0.0], [0.5, 0.0]], np.float32)
    found = np.array([[1.9, 0.0], [0.6, 0.0]], np.float32)

    result = compare_outputs(expected, found, continuous=True)

    assert result.same_actions == 1
    assert not result.is_equal


def test_an_output_that_is_no_number_is_never_equal():
    result = compare_outputs(
        np.ones((1, 2), np.float32), np.full((1, 2), np.nan, np.float32), continuous=False
    )

    assert result.same_actions == 0
    assert not result.is_equal


def made(kind: str, seed: int = 1) -> tuple[ActorCritic | SACAgent, PolicySpec]:
    """A network that prefers some actions."""
    torch.manual_seed(seed)
    spec = PolicySpec(
        num_actions=3 if kind == "discrete" else 2,
        continuous=kind != "discrete",
        network="COMPACT_CONVOLUTIONAL_NETWORK",
    )
    model = SACAgent(spec) if kind == "sac" else ActorCritic(spec)
    if isinstance(model, ActorCritic):
        with torch.no_grad():
            model.policy_head.weight.mul_(300.0)
    return model.eval(), spec
