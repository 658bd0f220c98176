"""Checkpoints of strangers: read if they are a policy, refused with the reason if not."""

import numpy as np
import pytest

from drcli.base.errors import SettingsError
from drcli.convert.imported_policy import read_reference_checkpoint
from drcli.convert.reference_layout import SCOPE, reference_layout
from drcli.convert.tensorflow.bundle import write_bundle

DEEP = "DEEP_CONVOLUTIONAL_NETWORK_DEEP"
CAMERA = "FRONT_FACING_CAMERA"
CONV = f"{SCOPE}network_1/{CAMERA}/Conv2d_2/kernel"


def checkpoint(*, network=DEEP, sensors=(CAMERA,), scope=SCOPE, continuous=False):
    """Variables of a model that the reference trained: its two bodies differ."""
    chance = np.random.default_rng(11)
    layout = reference_layout(
        network,
        sensors,
        scan_dims=64 if len(sensors) > 1 else 0,
        num_actions=2 if continuous else 4,
        continuous=continuous,
    )
    return {
        scope + name: chance.random(shape, np.float32) - np.float32(0.5)
        for name, shape in layout.items()
    }


def read(variables):
    return read_reference_checkpoint(*write_bundle(variables), "model/5_Step-500.ckpt")


def refusal(variables):
    with pytest.raises(SettingsError) as caught:
        read(variables)
    assert "model/5_Step-500.ckpt" in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_model_of_the_reference_is_read_with_a_fresh_critic():
    variables = checkpoint(continuous=True)

    found = read(variables)

    assert (found.network, found.sensors, found.continuous) == (DEEP, (CAMERA,), True)
    assert found.fresh_critic
    assert "critic starts fresh" in found.notes[0]
    assert not any(name.startswith(("value_head", "returns")) for name in found.weights)
    np.testing.assert_array_equal(
        found.weights["log_std"], variables[f"{SCOPE}network_1/ppo_head_0/policy_log_std"][0]
    )
    np.testing.assert_array_equal(
        found.weights["body.convolutions.1.weight"], variables[CONV].transpose(3, 2, 0, 1)
    )


def test_the_policy_is_read_from_its_own_body():
    variables = checkpoint()
    without_value = {n: a for n, a in variables.items() if not n.startswith(f"{SCOPE}network_0")}

    assert read(without_value).weights.keys() == read(variables).weights.keys()


def test_optimizer_and_counters_are_not_used_and_counted():
    extra = {
        "global_step": np.array(7, np.int64),
        f"{CONV}/Adam": np.zeros(3, np.float32),
        f"{CONV}/Adam_1": np.zeros(3, np.float32),
        "main_level/agent/main/target/network_1/x": np.zeros(3, np.float32),
    }

    assert read(checkpoint() | extra).notes[-1].startswith("4 other variables")


def test_a_model_of_several_trainers_is_read_from_its_shared_copy():
    variables = checkpoint(scope="main_level/agent_0/main/global/")

    assert read(variables).network == DEEP


def test_an_optional_rescaler_may_be_missing():
    variables = checkpoint()
    del variables[f"{SCOPE}network_1/gradients_from_head_0-0_rescalers"]

    assert read(variables).network == DEEP


@pytest.mark.parametrize("dtype", [np.float64, np.float16])
def test_weights_of_another_precision_are_converted_and_that_is_said(dtype):
    variables = checkpoint()
    variables[CONV] = variables[CONV].astype(dtype)

    found = read(variables)

    assert found.weights["body.convolutions.1.weight"].dtype == np.float32
    assert f"Weights of {np.dtype(dtype)} were converted to float32." in found.notes


def test_missing_variables_are_named():
    variables = checkpoint()
    del variables[CONV]

    said = refusal(variables)

    assert f"network_1/{CAMERA}/Conv2d_2/kernel is missing" in said
    assert DEEP in said


def test_wrong_shapes_are_named_with_the_most_similar_network():
    variables = checkpoint()
    variables[CONV] = np.zeros((4, 4, 32, 48), np.float32)

    said = refusal(variables)

    assert "Conv2d_2/kernel has the shape (4, 4, 32, 48) instead of (4, 4, 32, 32)" in said
    assert f"Compared with {DEEP}" in said


def test_further_layers_are_named():
    variables = checkpoint() | {
        f"{SCOPE}network_1/{CAMERA}/BatchnormActivationDropout_1_batchnorm/gamma": np.ones(
            32, np.float32
        )
    }

    assert "BatchnormActivationDropout_1_batchnorm/gamma is not known" in refusal(variables)


def test_many_differences_are_counted():
    variables = {
        name: array for name, array in checkpoint().items() if "Conv2d" not in name or "_0/" in name
    }

    assert "more differences" in refusal(variables)


@pytest.mark.parametrize(
    ("extra", "fault"),
    [
        ("network_1/LEFT_CAMERA/Conv2d_0/kernel", "LEFT_CAMERA; a policy here has one camera"),
        ("network_1/RADAR/Dense_0/kernel", "unknown part network_1/RADAR"),
    ],
)
def test_other_sensors_are_refused(extra, fault):
    variables = checkpoint() | {SCOPE + extra: np.zeros((2, 2), np.float32)}

    assert fault in refusal(variables)


def test_a_sac_model_is_named_as_such():
    variables = {
        "main_level/agent/policy/online/network_0/sac_policy_head_0/policy_mean/kernel": np.zeros(
            (256, 2), np.float32
        )
    }

    assert "SAC model" in refusal(variables)


def test_several_agents_are_refused():
    both = checkpoint() | {"main_level/agent_1/main/online/network_1/x": np.zeros(1, np.float32)}

    assert "several agents" in refusal(both)


@pytest.mark.parametrize("variables", [{}, {"dense/kernel": np.zeros(2, np.float32)}])
def test_a_checkpoint_of_something_else_is_refused(variables):
    assert "no policy of the reference simulator" in refusal(variables)


def test_weights_that_are_not_numbers_or_whole_numbers_are_refused():
    variables = checkpoint()
    bias = f"{SCOPE}network_1/ppo_head_0/policy_fc/bias"
    variables[bias][1] = np.inf
    with pytest.raises(SettingsError, match=r"data-00000-of-00001: .*policy_fc/bias has values"):
        read(variables)

    variables[bias] = np.zeros(4, np.int32)
    assert "weights of int32" in refusal(variables)


def test_huge_values_of_double_precision_are_not_silently_infinite():
    variables = checkpoint()
    bias = f"{SCOPE}network_1/ppo_head_0/policy_fc/bias"
    variables[bias] = np.full(4, 1e300)

    with pytest.raises(SettingsError, match="not finite"):
        read(variables)
