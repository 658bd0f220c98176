"""Graphs survive being written and read; whatever else is read is refused in a sentence."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drcli.base.errors import SettingsError
from drcli.convert.tensorflow.graph import (
    DataType,
    GraphMessage,
    Node,
    Shape,
    decode_graph,
    encode_graph,
)
from drcli.convert.tensorflow.interpreter import Graph

SMALL = [
    Node("in", "Placeholder", (), {"dtype": DataType.FLOAT, "shape": Shape((-1, 2))}),
    Node("w", "Const", value=np.arange(6, dtype=np.float32).reshape(2, 3)),
    Node("product", "MatMul", ("in", "w"), {"transpose_a": False, "T": DataType.FLOAT}),
    Node("out", "Softmax", ("product",), {"T": DataType.FLOAT}),
]


def one_const(**fields):
    """A graph of one constant, whose tensor has these fields."""
    graph = GraphMessage()
    node = graph.node.add(name="c", op="Const")
    tensor = node.attr.add(key="value").value.tensor
    tensor.dtype = DataType.FLOAT
    for name, value in fields.items():
        if name == "shape":
            for size in value:
                tensor.tensor_shape.dim.add(size=size)
        elif name == "float_val":
            tensor.float_val.extend(value)
        else:
            setattr(tensor, name, value)
    return graph.SerializeToString()


def test_nodes_are_the_same_after_writing_and_reading():
    back = decode_graph(encode_graph(SMALL), "model.pb")

    for before, after in zip(SMALL, back, strict=True):
        assert (before.name, before.op, before.inputs) == (after.name, after.op, after.inputs)
        assert before.attrs == after.attrs
        if before.value is not None:
            np.testing.assert_array_equal(before.value, after.value)


def test_equal_nodes_are_written_as_equal_bytes():
    assert encode_graph(SMALL) == encode_graph(list(decode_graph(encode_graph(SMALL), "m")))


def test_a_repeated_last_value_is_filled_up():
    [node] = decode_graph(one_const(shape=[2, 2], float_val=[1.0, 7.0]), "model.pb")

    np.testing.assert_array_equal(node.value, [[1.0, 7.0], [7.0, 7.0]])


def test_a_tensor_without_values_is_zero():
    [node] = decode_graph(one_const(shape=[3]), "model.pb")

    np.testing.assert_array_equal(node.value, [0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "no nodes"),
        (b"PK\x03\x04 not a graph", "not a TensorFlow graph"),
        (encode_graph(SMALL)[:-9], "not a TensorFlow graph"),
        (one_const(shape=[2], tensor_content=b"abc"), "not as long as its shape"),
        (one_const(shape=[1 << 40]), "has the shape"),
        (one_const(shape=[-1]), "has the shape"),
        (one_const(shape=[1], float_val=[1.0, 2.0]), "longer than its shape"),
        (one_const(dtype=7), "unknown type (7)"),
    ],
)
def test_what_is_no_graph_is_refused_with_its_name(data, why):
    with pytest.raises(SettingsError) as refusal:
        decode_graph(data, "model.pb")

    assert str(refusal.value).startswith("model.pb ")
    assert why in str(refusal.value)
    assert refusal.value.remedy


@given(st.data())
def test_damaged_bytes_are_refused_or_run(data):
    written = bytearray(encode_graph(SMALL))
    for _ in range(data.draw(st.integers(1, 4))):
        written[data.draw(st.integers(0, len(written) - 1))] = data.draw(st.integers(0, 255))

    refused = None
    try:
        graph = Graph(decode_graph(bytes(written), "model.pb"), "model.pb")
        graph.run({name: np.zeros((1, 2), np.float32) for name in graph.inputs})
    except SettingsError as error:
        refused = str(error)

    assert refused is None or refused.startswith("model.pb ")
