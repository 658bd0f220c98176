"""Our weights become the reference's variables and come back bit for bit."""

import numpy as np
import pytest
import torch

from drcli.base.errors import SettingsError
from drcli.convert.build_network import weights_of
from drcli.convert.imported_policy import read_reference_checkpoint
from drcli.convert.reference_checkpoint import (
    encode_reference_checkpoint,
    export_notes,
    reference_variables,
    refuse_other_networks,
)
from drcli.convert.tensorflow.bundle import DATA, INDEX, read_bundle
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import Observation, PolicySpec
from drcli.learn.sac_networks import SACAgent

SHALLOW = "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
PER_PIXEL = "DEEP_CONVOLUTIONAL_NETWORK"
DEEP = "DEEP_CONVOLUTIONAL_NETWORK_DEEP"
ONLINE = "main_level/agent/main/online/"

# The cameras differ in where their names stand among those of lidars.
CASES = [
    (SHALLOW, ["FRONT_FACING_CAMERA"], False),
    (SHALLOW, ["STEREO_CAMERAS", "SECTOR_LIDAR"], True),
    (DEEP, ["LEFT_CAMERA", "LIDAR"], True),
    (DEEP, ["FRONT_FACING_CAMERA", "DISCRETIZED_SECTOR_LIDAR"], False),
    (DEEP, ["observation"], False),
    (PER_PIXEL, ["FRONT_FACING_CAMERA"], True),
]
LIDAR_VALUES = {"LIDAR": 64, "SECTOR_LIDAR": 8, "DISCRETIZED_SECTOR_LIDAR": 56}


def policy_of(network=SHALLOW, sensors=("FRONT_FACING_CAMERA",), continuous=False, **changes):
    """A network as after a training, and its shape."""
    torch.manual_seed(5)
    spec = PolicySpec(
        num_actions=2 if continuous else 6,
        continuous=continuous,
        network=network,
        eyes=2 if "STEREO_CAMERAS" in sensors else 1,
        scan_dims=sum(LIDAR_VALUES.get(name, 0) for name in sensors),
        **changes,
    )
    model = ActorCritic(spec).eval()
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.dim() == 1:
                parameter.normal_(std=0.1)
        model.returns.scale.fill_(3.25)
    return model, spec


@pytest.mark.parametrize(("network", "sensors", "continuous"), CASES)
def test_weights_come_back_bit_for_bit(network, sensors, continuous):
    model, spec = policy_of(network, sensors, continuous)
    weights = weights_of(model)

    files = encode_reference_checkpoint(reference_variables(weights, spec, sensors))
    found = read_reference_checkpoint(files[INDEX], files[DATA], "5_Step-500.ckpt")

    assert (found.network, list(found.sensors), found.continuous) == (network, sensors, continuous)
    assert (found.eyes, found.scan_dims) == (spec.eyes, spec.scan_dims)
    assert found.num_actions == spec.num_actions
    assert found.algorithm == "clipped_ppo"
    for name, array in weights.items():
        if not name.startswith(("value_head", "returns")):
            assert found.weights[name].tobytes() == array.tobytes(), name


def test_a_checkpoint_of_ours_keeps_its_critic_in_units_of_reward():
    model, spec = policy_of(DEEP)
    files = encode_reference_checkpoint(
        reference_variables(weights_of(model), spec, ["FRONT_FACING_CAMERA"])
    )

    found = read_reference_checkpoint(files[INDEX], files[DATA], "x.ckpt")
    again = ActorCritic(spec).eval()
    again.load_state_dict({name: torch.from_numpy(a) for name, a in found.weights.items()})
    frames = torch.randint(0, 256, (3, 1, 120, 160), dtype=torch.uint8)
    seen = Observation(frames, torch.zeros(3, 0), torch.zeros(3, 0))
    with torch.no_grad():
        values = [net.returns(net(seen).value) for net in (model, again)]

    assert not found.fresh_critic
    torch.testing.assert_close(values[0], values[1], rtol=1e-5, atol=1e-6)


def test_both_bodies_are_the_one_of_the_model():
    model, spec = policy_of(DEEP)

    found = reference_variables(weights_of(model), spec, ["LEFT_CAMERA"])

    for name in (f"LEFT_CAMERA/{layer}/kernel" for layer in ("Conv2d_0", "Conv2d_6", "Dense_10")):
        value, policy = (found[f"{ONLINE}network_{body}/{name}"] for body in (0, 1))
        np.testing.assert_array_equal(value, policy)
    first = model.body.convolutions[0].weight.detach().numpy()
    kernel = found[f"{ONLINE}network_1/LEFT_CAMERA/Conv2d_0/kernel"]
    assert kernel[2, 3, 0, 7] == first[7, 0, 2, 3]
    assert found[f"{ONLINE}network_0/gradients_from_head_0-0_rescalers"] == 1.0


def test_the_rows_of_a_lidar_stand_where_its_name_does():
    model, spec = policy_of(SHALLOW, ["STEREO_CAMERAS", "LIDAR"])
    ours = model.body.dense[0].weight.detach().numpy()

    found = reference_variables(weights_of(model), spec, ["STEREO_CAMERAS", "LIDAR"])

    # LIDAR comes before STEREO_CAMERAS, but after LEFT_CAMERA; ours has the camera first.
    kernel = found[f"{ONLINE}network_1/middleware_fc_embedder/Dense_0/kernel"]
    np.testing.assert_array_equal(kernel[:256].T, ours[:, -256:])
    np.testing.assert_array_equal(kernel[256:].T, ours[:, :-256])


def test_a_critic_that_sees_the_state_leaves_the_value_at_zero_and_says_so():
    model, spec = policy_of(DEEP, state_dims=22)

    found = reference_variables(weights_of(model), spec, ["FRONT_FACING_CAMERA"])
    files = encode_reference_checkpoint(found)
    read = read_reference_checkpoint(files[INDEX], files[DATA], "x.ckpt")

    assert not found[f"{ONLINE}network_0/v_values_head_0/output/kernel"].any()
    assert "critic=state" in export_notes(weights_of(model), spec)[0]
    assert read.fresh_critic
    assert "value_head.weight" not in read.weights


def test_a_critic_that_has_not_learned_yet_is_said():
    model, spec = policy_of(DEEP)
    learned = export_notes(weights_of(model), spec)[0]
    with torch.no_grad():
        model.returns.scale.fill_(0.0)

    fresh = export_notes(weights_of(model), spec)[0]

    assert "units of reward" in learned
    assert "has not learned yet" in fresh


@pytest.mark.parametrize(
    ("changes", "is_sac", "reason"),
    [
        ({}, True, "training_algorithm=sac"),
        ({"network": "COMPACT_CONVOLUTIONAL_NETWORK"}, False, "COMPACT_CONVOLUTIONAL_NETWORK does"),
        ({"stack": 4}, False, "stack_size=4"),
    ],
)
def test_networks_that_the_reference_does_not_have_are_refused(changes, is_sac, reason):
    spec = PolicySpec(num_actions=2, continuous=True, **changes)

    with pytest.raises(SettingsError, match=reason) as refused:
        refuse_other_networks(spec, is_sac=is_sac)

    assert "`dr-export droa --distill`" in refused.value.remedy


def test_weights_of_sac_are_recognised():
    spec = PolicySpec(num_actions=2, continuous=True, network=DEEP)

    with pytest.raises(SettingsError, match="training_algorithm=sac"):
        reference_variables(weights_of(SACAgent(spec)), spec, ["FRONT_FACING_CAMERA"])


def test_weights_that_are_not_numbers_are_not_exported():
    model, spec = policy_of(DEEP)
    weights = weights_of(model)
    weights["body.dense.0.bias"][3] = np.nan

    with pytest.raises(SettingsError, match=r"middleware_fc_embedder/Dense_0/bias is not finite"):
        reference_variables(weights, spec, ["FRONT_FACING_CAMERA"])


def test_an_export_that_the_reference_would_not_read_completely_is_refused():
    model, spec = policy_of(DEEP)

    with pytest.raises(SettingsError, match="would not read this checkpoint completely: "):
        reference_variables(weights_of(model), spec, ["STEREO_CAMERAS"])


def test_tensorflow_restores_the_checkpoint_and_computes_the_same(tmp_path):
    tensorflow = pytest.importorskip("tensorflow", reason="TensorFlow is not installed.")
    from drcli.convert.frozen_graph import policy_nodes
    from drcli.convert.tensorflow.graph import encode_meta_graph

    sensors = ["FRONT_FACING_CAMERA"]
    model, spec = policy_of(DEEP, sensors, continuous=True)
    weights = weights_of(model)
    variables = reference_variables(weights, spec, sensors)
    files = encode_reference_checkpoint(variables)
    files[".meta"] = encode_meta_graph(policy_nodes(weights, spec, sensors), variables)
    for end, data in files.items():
        (tmp_path / f"x.ckpt{end}").write_bytes(data)
    frames = torch.randint(0, 256, (2, 1, 120, 160), dtype=torch.uint8)
    with torch.no_grad():
        wanted = model(Observation(frames, torch.zeros(2, 0), torch.zeros(2, 0))).policy.numpy()

    v1 = tensorflow.compat.v1
    with tensorflow.Graph().as_default(), v1.Session() as session:
        saver = v1.train.import_meta_graph(str(tmp_path / "x.ckpt.meta"))
        saver.restore(session, str(tmp_path / "x.ckpt"))
        camera = f"{ONLINE}network_0/FRONT_FACING_CAMERA/FRONT_FACING_CAMERA:0"
        found = session.run(
            f"{ONLINE}network_1/ppo_head_0/policy:0",
            {camera: frames.permute(0, 2, 3, 1).numpy().astype(np.float32)},
        )
        saver.save(session, str(tmp_path / "again.ckpt"), write_meta_graph=False)

    np.testing.assert_allclose(found, wanted, atol=1e-6)
    again = [(tmp_path / f"again.ckpt{end}").read_bytes() for end in (INDEX, DATA)]
    for name, values in read_bundle(*again, "again.ckpt").items():
        assert values.tobytes() == variables[name].tobytes()
