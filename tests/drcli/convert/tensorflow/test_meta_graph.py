"""The .meta file: a graph with the checkpoint's variables, and a saver that fits."""

import numpy as np

from drcli.convert.tensorflow.graph import MetaGraphMessage, Node, encode_meta_graph

NODES = [
    Node("in", "Placeholder"),
    Node("a/kernel", "Const", value=np.zeros((1, 1, 2, 3), np.float32)),
    Node("a/kernel/read", "Identity", ("a/kernel",)),
    Node("a/Conv2D", "Conv2D", ("in", "a/kernel/read")),
    Node("a/two", "Const", value=np.array(2.0, np.float32)),
    Node("a/out", "Mul", ("a/Conv2D", "a/two")),
]
VARIABLES = {"a/kernel": np.zeros((2, 3), np.float32), "b": np.array(1.0, np.float32)}


def written():
    file = MetaGraphMessage.FromString(encode_meta_graph(NODES, VARIABLES))
    return file, {node.name: node for node in file.graph_def.node}


def attr(node, key):
    return next(item.value for item in node.attr if item.key == key)


def test_weights_are_variables_and_other_constants_stay():
    _, nodes = written()

    assert nodes["a/kernel"].op == nodes["b"].op == "VariableV2"
    assert [dim.size for dim in attr(nodes["a/kernel"], "shape").shape.dim] == [2, 3]
    assert attr(nodes["b"], "shape").WhichOneof("value") == "shape"
    assert nodes["a/two"].op == "Const"


def test_a_kernel_with_other_dimensions_in_the_graph_is_reshaped():
    _, nodes = written()

    read = nodes["a/kernel/read"]
    assert (read.op, list(read.input)) == ("Reshape", ["a/kernel", "a/kernel/read/shape"])


def test_the_saver_reads_and_writes_every_variable():
    file, nodes = written()

    saver = file.saver_def
    assert saver.filename_tensor_name.removesuffix(":0") in nodes
    assert saver.save_tensor_name.removesuffix(":0") in nodes
    restored = [name.removeprefix("^") for name in nodes[saver.restore_op_name].input]
    assert [nodes[name].input[0] for name in restored] == sorted(VARIABLES)
    assert list(nodes["save/SaveV2"].input[3:]) == sorted(VARIABLES)
    for end in ("SaveV2", "RestoreV2"):
        names = attr(nodes[f"save/{end}/tensor_names"], "value").tensor.string_val
        assert [name.decode() for name in names] == sorted(VARIABLES)
        assert list(attr(nodes[f"save/{end}"], "dtypes").list.type) == [1, 1]


def test_every_input_of_a_node_exists():
    _, nodes = written()

    for node in nodes.values():
        for name in node.input:
            assert name.removeprefix("^").partition(":")[0] in nodes


def test_equal_weights_give_equal_files():
    assert encode_meta_graph(NODES, VARIABLES) == encode_meta_graph(NODES, dict(VARIABLES))
