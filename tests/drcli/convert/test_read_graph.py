"""Frozen graphs become our networks, or are refused with a reason."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from drcli.base.errors import SettingsError
from drcli.convert.build_network import load_arrays, weights_of
from drcli.convert.frozen_graph import encode_policy, policy_nodes
from drcli.convert.read_graph import read_graph, read_nodes
from drcli.convert.tensorflow.graph import Node, Shape, encode_graph
from drcli.convert.tensorflow.interpreter import Graph
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import Observation, PolicySpec
from drcli.learn.sac_networks import SACAgent

COMPACT = "COMPACT_CONVOLUTIONAL_NETWORK"
DEEP = "DEEP_CONVOLUTIONAL_NETWORK_DEEP"
MODEL_30 = Path("../shared/reference-models/model_30.pb")
AGENT = "main_level/agent/main/online"
CAMERA = f"{AGENT}/network_0/FRONT_FACING_CAMERA/FRONT_FACING_CAMERA"


def trained(spec):
    """Weights that no initialization has: biases that are not 0, and a decided policy."""
    torch.manual_seed(1)
    model = ActorCritic(spec).eval()
    for parameter in model.parameters():
        parameter.data = parameter.data * 1.3 + 0.02 * torch.randn_like(parameter)
    return model


def written(spec, sensors=("FRONT_FACING_CAMERA",)):
    return list(policy_nodes(weights_of(trained(spec)), spec, sensors))


def changed(nodes, name, **changes):
    """The nodes, one of them different."""
    assert any(node.name.endswith(name) for node in nodes)
    return [replace(node, **changes) if node.name.endswith(name) else node for node in nodes]


@pytest.mark.parametrize(
    ("spec", "sensors"),
    [
        (PolicySpec(5, network=COMPACT), ("FRONT_FACING_CAMERA",)),
        (PolicySpec(2, True, COMPACT, scan_dims=8), ("observation", "SECTOR_LIDAR")),
        (PolicySpec(4, network=COMPACT, eyes=2, scan_dims=64), ("LIDAR", "STEREO_CAMERAS")),
        (PolicySpec(3, network=DEEP, stack=2), ("LEFT_CAMERA",)),
    ],
)
def test_what_was_written_is_read_bit_for_bit(spec, sensors):
    weights = weights_of(trained(spec))

    read = read_graph(encode_policy(weights, spec, sensors), "model.pb")

    assert read.spec == spec
    assert sorted(read.sensors) == sorted(sensors)
    assert read.algorithm == "clipped_ppo"
    missing = {"value_head.weight", "value_head.bias", "returns.scale", "returns.weight", "log_std"}
    assert weights.keys() - read.weights.keys() <= missing
    assert all(np.array_equal(weights[name], array) for name, array in read.weights.items())


def test_a_dense_layer_on_every_pixel_may_be_a_chain_of_reshapes():
    spec = PolicySpec(3, network=DEEP)
    nodes = []
    for node in written(spec):
        is_dense = node.op == "Conv2D" and "Dense" in node.name
        nodes += tensordot(node, written(spec)) if is_dense else [node]
    taken = {name for node in nodes for name in node.inputs}
    nodes = [node for node in nodes if node.name in taken or node.op == "Softmax"]
    taken = {name for node in nodes for name in node.inputs}
    nodes = [node for node in nodes if node.name in taken or node.op == "Softmax"]

    read = read_nodes(nodes, "model.pb")

    expected = weights_of(trained(spec))
    assert np.array_equal(
        read.weights["body.per_pixel.1.weight"], expected["body.per_pixel.1.weight"]
    )
    assert read.network == DEEP


def tensordot(node, nodes):
    """TensorFlow's form of a dense layer on pictures, with shapes that are computed."""
    picture, kernel = node.inputs
    name = node.name
    values = next(n.value for n in nodes if f"{n.name}/read" == kernel)[0, 0]
    inputs, outputs = values.shape

    def ints(end, *numbers):
        return Node(f"{name}/{end}", "Const", value=np.array(numbers, np.int32))

    def add(end, op, *inputs, **attrs):
        return Node(
            f"{name}/{end}",
            op,
            tuple(f"{name}/{i}" if "main_level" not in i else i for i in inputs),
            attrs,
        )

    zero = Node(f"{name}/zero", "Const", value=np.array(0, np.int32))
    return [
        Node(f"{name}/w", "Const", value=values),
        ints("free", 0, 1, 2),
        ints("axes", 3),
        ints("outputs", outputs),
        ints("order", 1, 0),
        ints("rows", inputs, outputs),
        ints("reduce", 0),
        zero,
        add("Shape", "Shape", picture),
        add("free_dims", "GatherV2", "Shape", "free", "zero"),
        add("contracted", "GatherV2", "Shape", "axes", "zero"),
        add("free_size", "Prod", "free_dims", "reduce"),
        add("size", "Prod", "contracted", "reduce"),
        add("flat", "Pack", "free_size", "size", axis=0),
        add("perm", "ConcatV2", "free", "axes", "zero"),
        add("transposed", "Transpose", picture, "perm"),
        add("matrix", "Reshape", "transposed", "flat"),
        add("twice", "Transpose", "w", "order"),
        add("back", "Transpose", "twice", "order"),
        add("kernel_rows", "Reshape", "back", "rows"),
        add("product", "MatMul", "matrix", "kernel_rows"),
        add("whole", "ConcatV2", "free_dims", "outputs", "zero"),
        Node(name, "Reshape", (f"{name}/product", f"{name}/whole")),
    ]


def test_batch_norm_with_constants_is_part_of_its_layer():
    spec = PolicySpec(3, network=COMPACT)
    nodes = written(spec)
    place = next(i for i, node in enumerate(nodes) if node.name.endswith("Conv2d_2/BiasAdd"))
    layer = nodes[place].name
    random = np.random.default_rng(0)
    values = {name: random.uniform(0.5, 1.5, 32).astype(np.float32) for name in ("mean", "scale")}
    norm = [Node(f"{layer}/{name}", "Const", value=value) for name, value in values.items()]
    norm.append(Node(f"{layer}/sub", "Sub", (layer, f"{layer}/mean")))
    norm.append(Node(f"{layer}/mul", "Mul", (f"{layer}/sub", f"{layer}/scale")))
    relu = replace(nodes[place + 1], inputs=(f"{layer}/mul",))
    assert relu.op == "Relu"
    nodes = [*nodes[: place + 1], *norm, relu, *nodes[place + 2 :]]

    read = read_nodes(nodes, "model.pb")

    model = ActorCritic(spec).eval()
    load_arrays(model, read.weights)
    frames = random.integers(0, 256, (3, 1, 120, 160), np.uint8)
    seen = Observation.of_arrays(frames, np.zeros((3, 0), np.float32), np.zeros((3, 0), np.float32))
    with torch.inference_mode():
        ours = model(seen).policy.softmax(-1).numpy()
    theirs = Graph(nodes, "x").run({CAMERA: frames.transpose(0, 2, 3, 1).astype(np.float32)})
    assert np.abs(ours - theirs).max() < 1e-5


REFUSED = {
    "is not a known sensor": lambda nodes: [
        replace(
            node,
            name=node.name.replace("FRONT_FACING_CAMERA/FRONT_FACING_CAMERA", "FRONT/SONAR"),
            inputs=tuple(
                i.replace("_0/FRONT_FACING_CAMERA/FRONT_FACING_CAMERA", "_0/FRONT/SONAR")
                for i in node.inputs
            ),
        )
        if node.op == "Placeholder" or node.op == "RealDiv"
        else node
        for node in nodes
    ],
    "of the shape \\? x 240 x 320 x 1, not \\? x 120 x 160 x 1": lambda nodes: changed(
        nodes,
        "_0/FRONT_FACING_CAMERA/FRONT_FACING_CAMERA",
        attrs={"shape": Shape((-1, 240, 320, 1))},
    ),
    "has the operation LSTM": lambda nodes: changed(
        nodes, "BatchnormActivationDropout_3_activation", op="LSTM"
    ),
    "is no policy that can be trained here: it has Tanh": lambda nodes: changed(
        nodes, "BatchnormActivationDropout_3_activation", op="Tanh"
    ),
    "computes something else": lambda nodes: changed(
        nodes, "truediv/y", value=np.array(128.0, np.float32)
    ),
    "computes something else, such as": lambda nodes: changed(
        nodes, "BatchnormActivationDropout_3_activation", op="Identity"
    ),
    "has 2 outputs instead of one": lambda nodes: [
        *nodes,
        Node(f"{AGENT}/network_0/v_values", "Identity", (nodes[-2].name,)),
    ],
    "has a network that is not known here: its layers are 8x8x1x16": lambda nodes: [
        node
        for node in changed(
            nodes,
            "network_1/ppo_head_0/policy",
            inputs=(
                f"{AGENT}/network_1/middleware_fc_embedder/BatchnormActivationDropout_1_activation",
            ),
        )
        if "policy_fc" not in node.name
    ],
    "is damaged: BiasAdd at .* does not take two values": lambda nodes: [
        node
        for node in changed(
            nodes,
            "Conv2d_2/BiasAdd",
            inputs=(f"{AGENT}/network_1/FRONT_FACING_CAMERA/Conv2d_2/Conv2D",),
        )
        if "Conv2d_2/bias" not in node.name
    ],
    "is damaged: .* not finite": lambda nodes: changed(
        nodes, "Conv2d_2/bias", value=np.full(32, np.nan, np.float32)
    ),
    "has 33 channels for FRONT_FACING_CAMERA": lambda nodes: changed(
        nodes, "Conv2d_0/kernel", value=np.zeros((8, 8, 33, 16), np.float32)
    ),
    "is not known here: .* 12x256, 256x3": lambda nodes: changed(
        nodes, "Dense_0/kernel", value=np.zeros((12, 256), np.float32)
    ),
}


@pytest.mark.parametrize("reason", REFUSED)
def test_another_graph_is_refused_with_the_reason(reason):
    nodes = REFUSED[reason](written(PolicySpec(3, network=COMPACT)))

    with pytest.raises(SettingsError, match=reason) as caught:
        read_nodes(nodes, "model.pb")

    assert str(caught.value).startswith("model.pb ")
    assert "\n" not in str(caught.value)
    assert caught.value.remedy


def test_other_strides_compute_something_else():
    nodes = written(PolicySpec(3, network=COMPACT))
    stride = next(node for node in nodes if node.name.endswith("Conv2d_0/Conv2D"))
    nodes = changed(nodes, "Conv2d_0/Conv2D", attrs={**stride.attrs, "strides": (1, 4, 5, 1)})

    with pytest.raises(SettingsError, match=r"model\.pb "):
        read_nodes(nodes, "model.pb")


@pytest.mark.parametrize("spec", [PolicySpec(2, True, COMPACT)])
def test_a_sac_policy_can_be_raced_but_not_trained_on(spec):
    agent = SACAgent(spec)
    data = encode_policy(weights_of(agent), spec, ["FRONT_FACING_CAMERA"])

    with pytest.raises(
        SettingsError, match="is a SAC policy, which cannot be trained on"
    ) as caught:
        read_graph(data, "sac.pb")

    assert "`dr-evaluate --model sac.pb`" in caught.value.remedy


@pytest.mark.parametrize("cut", [0, 1, 100, 5000, -10])
def test_a_truncated_file_is_refused(cut):
    data = encode_graph(written(PolicySpec(3, network=COMPACT)))

    with pytest.raises(SettingsError, match=r"model\.pb "):
        read_graph(data[:cut], "model.pb")


@pytest.mark.skipif(not MODEL_30.is_file(), reason="the reference's model is not here")
def test_a_model_of_the_reference_is_read_and_written_again_bit_for_bit():
    read = read_graph(MODEL_30.read_bytes(), "model_30.pb")

    again = read_graph(encode_policy(read.weights, read.spec, read.sensors), "again.pb")

    assert read.network == "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
    assert (read.num_actions, read.continuous, read.sensors) == (
        12,
        False,
        ("FRONT_FACING_CAMERA",),
    )
    assert all(np.array_equal(again.weights[name], array) for name, array in read.weights.items())
