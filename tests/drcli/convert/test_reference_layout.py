"""The list of the reference's variables equals what TensorFlow gives for its networks."""

import json
from pathlib import Path

import pytest

from drcli.convert.reference_layout import SCOPE, differences, reference_layout
from drcli.convert.tensorflow.graph import decode_graph

GOLDEN = json.loads(
    (Path(__file__).parents[2] / "data" / "tensorflow" / "variables.json").read_text()
)
"""Made by TensorFlow 2.12.1; the file says how."""

REFERENCE_GRAPH = Path(__file__).parents[4] / "shared" / "reference-models" / "model_30.pb"

LIDAR_VALUES = {"LIDAR": 64, "SECTOR_LIDAR": 8, "DISCRETIZED_SECTOR_LIDAR": 64}


@pytest.mark.parametrize("key", GOLDEN["networks"])
def test_the_list_has_the_names_and_shapes_of_tensorflow(key):
    network, camera, lidar, continuous = key.split("|")
    sensors = [camera] if lidar == "None" else [camera, lidar]

    found = reference_layout(
        network,
        sensors,
        scan_dims=LIDAR_VALUES.get(lidar, 0),
        num_actions=2 if continuous == "True" else 5,
        continuous=continuous == "True",
    )

    assert {name: list(shape) for name, shape in found.items()} == GOLDEN["networks"][key]
    assert GOLDEN["scope"] == SCOPE


def test_a_continuous_shallow_model_has_the_23_variables_of_a_console_checkpoint():
    found = reference_layout(
        "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
        ["FRONT_FACING_CAMERA"],
        scan_dims=0,
        num_actions=2,
        continuous=True,
    )

    assert len(found) == 23
    assert found["network_1/ppo_head_0/policy_log_std"] == (1, 2)
    assert found["network_0/middleware_fc_embedder/Dense_0/kernel"] == (11264, 512)


def test_differences_name_what_is_missing_unknown_and_of_another_shape():
    assert differences({"a": (1,), "b": (2, 3)}, {"b": (2, 4), "c": ()}) == [
        "c is missing",
        "a is not known",
        "b has the shape (2, 3) instead of (2, 4)",
    ]
    assert differences({"a": ()}, {"a": ()}) == []


def test_a_graph_that_the_reference_wrote_has_these_variables():
    if not REFERENCE_GRAPH.exists():
        pytest.skip("the frozen graph of the reference is not here")
    nodes = decode_graph(REFERENCE_GRAPH.read_bytes(), "model_30.pb")
    written = {
        node.name.removeprefix(SCOPE): node.value.shape
        for node in nodes
        if node.value is not None and node.name.endswith(("/kernel", "/bias"))
    }

    wanted = reference_layout(
        "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
        ["FRONT_FACING_CAMERA"],
        scan_dims=0,
        num_actions=12,
        continuous=False,
    )

    policy = {
        name: shape
        for name, shape in wanted.items()
        if name.startswith("network_1/") and not name.endswith("rescalers")
    }
    assert written == policy
