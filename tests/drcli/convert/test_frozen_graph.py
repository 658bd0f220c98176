"""Policies as frozen graphs compute what they compute in PyTorch."""

import numpy as np
import pytest
import torch

from drcli.convert.build_network import weights_of
from drcli.convert.frozen_graph import encode_policy
from drcli.convert.tensorflow.graph import decode_graph
from drcli.convert.tensorflow.interpreter import Graph
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import Observation, PolicySpec
from drcli.learn.sac_networks import SACAgent

SHALLOW = "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
DEEP = "DEEP_CONVOLUTIONAL_NETWORK_DEEP"
PER_PIXEL = "DEEP_CONVOLUTIONAL_NETWORK"
COMPACT = "COMPACT_CONVOLUTIONAL_NETWORK"

# The cameras differ in where their names stand among those of lidars.
CASES = [
    (SHALLOW, ["FRONT_FACING_CAMERA"], "discrete"),
    (SHALLOW, ["LEFT_CAMERA", "LIDAR"], "continuous"),
    (SHALLOW, ["observation"], "sac"),
    (COMPACT, ["FRONT_FACING_CAMERA"], "continuous"),
    (COMPACT, ["observation", "LIDAR"], "discrete"),
    (COMPACT, ["STEREO_CAMERAS", "SECTOR_LIDAR"], "sac"),
    (DEEP, ["FRONT_FACING_CAMERA"], "discrete"),
    (DEEP, ["FRONT_FACING_CAMERA", "DISCRETIZED_SECTOR_LIDAR"], "sac"),
    (PER_PIXEL, ["FRONT_FACING_CAMERA"], "continuous"),
    (PER_PIXEL, ["STEREO_CAMERAS"], "discrete"),
]
LIDAR_VALUES = {"LIDAR": 64, "SECTOR_LIDAR": 8, "DISCRETIZED_SECTOR_LIDAR": 56}


@pytest.mark.parametrize(("network", "sensors", "head"), CASES)
def test_a_graph_computes_what_the_network_computes(network, sensors, head):
    torch.manual_seed(3)
    spec = PolicySpec(
        num_actions=6 if head == "discrete" else 2,
        continuous=head != "discrete",
        network=network,
        eyes=2 if "STEREO_CAMERAS" in sensors else 1,
        scan_dims=sum(LIDAR_VALUES.get(name, 0) for name in sensors),
    )
    model = trained(SACAgent(spec) if head == "sac" else ActorCritic(spec))
    frames = torch.randint(0, 256, (3, spec.eyes, 120, 160), dtype=torch.uint8)
    scans = torch.rand(3, spec.scan_dims)

    data = encode_policy(weights_of(model), spec, sensors)
    graph = Graph(decode_graph(data, "model.pb"), "model.pb")
    found = graph.run(
        {
            name: scans.numpy()
            if name.endswith("LIDAR")
            else frames.permute(0, 2, 3, 1).numpy().astype(np.float32)
            for name in graph.inputs
        }
    )

    wanted = policy_of(model, Observation(frames, scans, torch.zeros(3, 0)))
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    assert np.ptp(wanted, axis=0).max() > 1e-3, "the network does not look at the frames"


@pytest.mark.parametrize(
    ("sensor", "head", "agent"),
    [("FRONT_FACING_CAMERA", "discrete", "main"), ("STEREO_CAMERAS", "sac", "policy")],
)
def test_inputs_and_output_have_the_names_that_the_car_looks_for(sensor, head, agent):
    spec = PolicySpec(2, head == "sac", COMPACT, 2 if sensor == "STEREO_CAMERAS" else 1)
    model = SACAgent(spec) if head == "sac" else ActorCritic(spec)

    graph = Graph(decode_graph(encode_policy(weights_of(model), spec, [sensor]), "m"), "m")

    top = f"main_level/agent/{agent}/online"
    assert graph.inputs == {f"{top}/network_0/{sensor}/{sensor}": (-1, 120, 160, spec.eyes)}
    assert graph.output.name == f"{top}/network_1/ppo_head_0/policy"


def trained(model):
    """Weights of which none is 0 and whose actions differ, as after a training."""
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += 0.02 * torch.randn_like(parameter)
        if isinstance(model, ActorCritic):
            model.policy_head.weight.mul_(20.0)
    return model.eval()


@torch.inference_mode()
def policy_of(model, seen: Observation):
    if isinstance(model, SACAgent):
        mean, _ = model(model.features(seen))
        return torch.tanh(mean).numpy()
    policy = model(seen).policy
    return (policy if model.spec.continuous else policy.softmax(-1)).numpy()
