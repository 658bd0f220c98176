"""The interpreter computes what TensorFlow defines, and refuses everything else."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from drcli.base.errors import SettingsError
from drcli.convert.tensorflow.graph import Attr, Node, Shape
from drcli.convert.tensorflow.interpreter import Graph

RANDOM = np.random.default_rng(7)


def graph(*nodes: Node) -> Graph:
    return Graph(nodes, "model.pb")


def const(name: str, value) -> Node:
    return Node(name, "Const", value=np.asarray(value))


def run(op: str, *values, **attrs: Attr):
    """One operation on constants."""
    names = tuple(f"c{number}" for number in range(len(values)))
    constants = [const(name, value) for name, value in zip(names, values, strict=True)]
    return graph(*constants, Node("out", op, names, attrs)).run({})


def normal(*shape: int):
    return RANDOM.standard_normal(shape, dtype=np.float32)


@pytest.mark.parametrize("stride", [(1, 1), (2, 1), (4, 3)])
def test_a_convolution_is_torchs_with_channels_last(stride):
    images, kernel = normal(2, 13, 17, 3), normal(5, 4, 3, 6)

    found = run("Conv2D", images, kernel, strides=(1, *stride, 1), padding="VALID")

    wanted = functional.conv2d(
        torch.from_numpy(images).permute(0, 3, 1, 2),
        torch.from_numpy(kernel).permute(3, 2, 0, 1),
        stride=stride,
    )
    np.testing.assert_allclose(found, wanted.permute(0, 2, 3, 1), rtol=1e-4, atol=1e-4)


def test_the_softmax_of_large_numbers_is_finite():
    np.testing.assert_allclose(run("Softmax", np.float32([[1e4, 1e4]])), [[0.5, 0.5]])


def test_matrices_are_transposed_where_an_attribute_says_so():
    a, b = normal(3, 2), normal(4, 3)

    np.testing.assert_allclose(
        run("MatMul", a, b, transpose_a=True, transpose_b=True), a.T @ b.T, rtol=1e-6
    )


def test_a_slice_obeys_its_masks():
    values = normal(4, 5)
    begin, end, step = (np.array(n, np.int32) for n in ([1, 2], [3, 4], [1, 1]))

    shrunk = run("StridedSlice", values, begin, end, step, shrink_axis_mask=1, end_mask=2)

    np.testing.assert_array_equal(shrunk, values[1, 2:])


def test_a_dense_layer_on_pixels_as_the_reference_writes_it():
    """A product of a 4-D array and a matrix: shape, gather, product, transpose, reshape."""
    pixels, kernel = normal(2, 3, 4, 5), normal(5, 6)
    nodes = [
        Node("in", "Placeholder", (), {"shape": Shape((-1, 3, 4, 5))}),
        const("kernel", kernel),
        const("free", np.array([0, 1, 2], np.int32)),
        const("last", np.array([3], np.int32)),
        const("zero", np.array(0, np.int32)),
        const("axes", np.array([0], np.int32)),
        const("order", np.array([0, 1, 2, 3], np.int32)),
        const("width", np.array([6], np.int32)),
        Node("shape", "Shape", ("in",)),
        Node("rows", "GatherV2", ("shape", "free", "zero")),
        Node("columns", "GatherV2", ("shape", "last", "zero")),
        Node("row", "Prod", ("rows", "axes")),
        Node("column", "Prod", ("columns", "axes")),
        Node("flat", "Pack", ("row", "column"), {"axis": 0}),
        Node("ordered", "Transpose", ("in", "order")),
        Node("matrix", "Reshape", ("ordered", "flat")),
        Node("product", "MatMul", ("matrix", "kernel")),
        Node("whole", "ConcatV2", ("rows", "width", "zero")),
        Node("out", "Reshape", ("product", "whole")),
    ]

    np.testing.assert_allclose(graph(*nodes).run({"in": pixels}), pixels @ kernel, rtol=1e-5)


def test_only_what_the_output_needs_is_an_input():
    nodes = [
        Node("used", "Placeholder", (), {"shape": Shape((-1, 2))}),
        Node("out", "Relu", ("used",)),
    ]

    assert graph(*nodes).inputs == {"used": (-1, 2)}


@pytest.mark.parametrize(
    ("nodes", "why"),
    [
        ([Node("a", "PyFunc")], "operation PyFunc"),
        ([Node("a", "Relu", ("b",))], "takes the result of b"),
        ([Node("a", "Relu", ("b",)), Node("b", "Relu", ("a",))], "0 outputs"),
        ([const("a", [1.0]), const("b", [1.0])], "2 outputs"),
        ([const("a", [1.0]), const("a", [1.0])], "two nodes of one name"),
        (
            [Node("a", "Relu", ("b",)), Node("b", "Relu", ("a",)), Node("o", "Add", ("a", "b"))],
            "circle",
        ),
        (
            [const("a", np.ones((2, 3))), const("b", np.ones(4)), Node("o", "BiasAdd", ("a", "b"))],
            "4 biases for 3 channels",
        ),
        (
            [
                const("a", np.ones((1, 9, 9, 1))),
                const("b", np.ones((3, 3, 1, 1))),
                Node("o", "Conv2D", ("a", "b"), {"strides": (1, 1, 1, 1), "padding": "SAME"}),
            ],
            "padding is SAME, not VALID",
        ),
    ],
)
def test_a_graph_that_cannot_run_is_refused(nodes, why):
    with pytest.raises(SettingsError) as refusal:
        graph(*nodes).run({})

    assert why in str(refusal.value)
    assert str(refusal.value).startswith("model.pb ")


def test_a_graph_that_grows_without_end_is_refused(monkeypatch):
    monkeypatch.setattr("drcli.convert.tensorflow.interpreter._MOST_BYTES", 1 << 20)
    nodes = [const("n0", np.ones((1, 1 << 10), np.float32)), const("axis", np.array(0))]
    nodes += [Node(f"n{k + 1}", "ConcatV2", (f"n{k}", f"n{k}", "axis")) for k in range(40)]

    with pytest.raises(SettingsError, match="grows too large"):
        graph(*nodes).run({})
