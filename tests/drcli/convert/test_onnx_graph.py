"""Policies as ONNX: the same numbers, and the same graph when it is read again."""

from pathlib import Path

import numpy as np
import pytest

from drcli.base.errors import NotAvailable, SettingsError
from drcli.convert.build_network import weights_of
from drcli.convert.frozen_graph import policy_nodes
from drcli.convert.onnx_graph import encode_onnx
from drcli.convert.onnx_reader import read_onnx
from drcli.convert.tensorflow.graph import Node, Shape, decode_graph, encode_graph
from drcli.convert.tensorflow.interpreter import Graph
from small_policies import small_metadata, small_network

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

REFERENCE = Path(__file__).resolve().parents[4] / "shared" / "reference-models" / "model_30.pb"

CASES = [
    ("discrete", ["FRONT_FACING_CAMERA"]),
    ("continuous", ["STEREO_CAMERAS", "LIDAR"]),
    ("sac", ["observation", "SECTOR_LIDAR"]),
]


def nodes_of(head, sensors, **changes):
    metadata = small_metadata(head, sensor=sensors, **changes)
    model = small_network(metadata)
    return policy_nodes(weights_of(model), model.spec, metadata.sensor)


def random_feeds(graph, rows=3):
    random = np.random.default_rng(0)
    return {
        name: random.integers(0, 256, (rows, *shape[1:])).astype(np.float32)
        if len(shape) == 4
        else random.random((rows, *shape[1:]), np.float32)
        for name, shape in graph.inputs.items()
    }


@pytest.mark.parametrize(("head", "sensors"), CASES)
def test_onnxruntime_computes_what_the_frozen_graph_computes(head, sensors):
    nodes = nodes_of(head, sensors)
    graph = Graph(nodes, "model.pb")
    feeds = random_feeds(graph)

    session = onnxruntime.InferenceSession(encode_onnx(nodes, "model.pb"))

    assert [port.name for port in session.get_inputs()] == list(graph.inputs)
    assert {port.shape[0] for port in session.get_inputs()} == {"batch"}
    [output] = session.get_outputs()
    assert output.name == graph.output.name
    found = session.run(None, feeds)[0]
    np.testing.assert_allclose(found, graph.run(feeds), atol=1e-5)
    assert np.ptp(found, axis=0).max() > 1e-3


@pytest.mark.parametrize(("head", "sensors"), CASES)
def test_a_graph_comes_back_bit_for_bit(head, sensors):
    nodes = nodes_of(head, sensors)

    found = read_onnx(encode_onnx(nodes, "model.pb"), "model.onnx")

    assert encode_graph(found) == encode_graph(nodes)


def test_a_network_with_a_layer_per_pixel_comes_back_too():
    nodes = nodes_of(
        "discrete", ["FRONT_FACING_CAMERA"], neural_network="DEEP_CONVOLUTIONAL_NETWORK"
    )

    found = read_onnx(encode_onnx(nodes, "model.pb"), "model.onnx")

    assert encode_graph(found) == encode_graph(nodes)


def test_equal_graphs_give_equal_files():
    nodes = nodes_of("discrete", ["FRONT_FACING_CAMERA"])

    assert encode_onnx(nodes, "a.pb") == encode_onnx(nodes, "b.pb")


def test_a_graph_of_the_reference_becomes_onnx():
    if not REFERENCE.exists():
        pytest.skip("needs a graph of the reference")
    nodes = decode_graph(REFERENCE.read_bytes(), "model_30.pb")
    graph = Graph(nodes, "model_30.pb")
    feeds = random_feeds(graph, rows=2)

    session = onnxruntime.InferenceSession(encode_onnx(nodes, "model_30.pb"))

    np.testing.assert_allclose(session.run(None, feeds)[0], graph.run(feeds), atol=1e-6)


def test_arithmetic_that_only_other_graphs_have_is_written():
    """Slices, transposed products, gathers: operations around the policies of the reference."""
    wide = np.arange(12, dtype=np.float32).reshape(3, 4)

    def const(name, value):
        return Node(name, "Const", value=np.asarray(value))

    nodes = [
        Node("x", "Placeholder", (), {"shape": Shape((-1, 4))}),
        const("wide", wide),
        Node("product", "MatMul", ("x", "wide"), {"transpose_b": True}),
        const("order", np.array([2, 0], np.int32)),
        const("one", np.array(1, np.int32)),
        Node("gathered", "GatherV2", ("product", "order", "one")),
        const("begin", np.array([0, 1], np.int32)),
        const("end", np.array([0, 2], np.int32)),
        const("step", np.array([1, 1], np.int32)),
        Node(
            "sliced",
            "StridedSlice",
            ("gathered", "begin", "end", "step"),
            {"begin_mask": 1, "end_mask": 1},
        ),
        const("perm", np.array([1, 0], np.int32)),
        Node("turned", "Transpose", ("sliced", "perm")),
        Node("back", "Transpose", ("turned", "perm")),
        Node("out", "Tanh", ("back",)),
    ]
    graph = Graph(nodes, "odd.pb")
    feeds = {"x": np.array([[0.1, 0.2, 0.0, -0.1], [0.0, 0.05, 0.1, 0.0]], np.float32)}

    session = onnxruntime.InferenceSession(encode_onnx(nodes, "odd.pb"))

    np.testing.assert_allclose(session.run(None, feeds)[0], graph.run(feeds), atol=1e-6)


def test_a_kernel_that_is_computed_is_refused():
    nodes = [
        Node("x", "Placeholder", (), {"shape": Shape((-1, 4, 4, 1))}),
        Node("kernel", "Placeholder", (), {"shape": Shape((1, 1, 1, 1))}),
        Node("out", "Conv2D", ("x", "kernel"), {"strides": (1, 1, 1, 1), "padding": "VALID"}),
    ]

    with pytest.raises(SettingsError, match=r"odd.pb cannot be written as ONNX: Conv2D of out"):
        encode_onnx(nodes, "odd.pb")


def test_without_the_package_it_is_named(monkeypatch):
    monkeypatch.setattr("drcli.base.installation.is_installed", lambda name: False)

    with pytest.raises(NotAvailable, match="package onnx") as caught:
        encode_onnx(nodes_of("discrete", ["FRONT_FACING_CAMERA"]), "model.pb")

    assert caught.value.remedy == 'Install it with `pip install "drcli[onnx]"`.'
    assert caught.value.code == 7
