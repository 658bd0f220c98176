"""The `.meta` file of a checkpoint: a graph with variables, for `import_meta_graph`.

The reference simulator never reads it, but importers ask for it.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drcli.formats.tensorflow.graph import Array, Attr, Node, Shape, data_type, graph_message
from drcli.formats.tensorflow.messages import DataType, MetaGraphMessage

_STRING = 7
_SAVER_V2 = 2
_VERSION = "1.12.0"
"""Of the consoles."""

_SAVE = "save/"


def encode_meta_graph(nodes: Sequence[Node], variables: Mapping[str, Array]) -> bytes:
    """Constants with the name of a variable become that variable."""
    file = MetaGraphMessage()
    file.meta_info_def.tags.append("serve")
    file.meta_info_def.tensorflow_version = _VERSION
    graph = graph_message(_with_variables(nodes, variables))
    names = sorted(variables)
    _add_save(graph, names, variables)
    _add_restore(graph, names, variables)
    file.graph_def.CopyFrom(graph)
    saver = file.saver_def
    saver.filename_tensor_name = f"{_SAVE}Const:0"
    saver.save_tensor_name = f"{_SAVE}control_dependency:0"
    saver.restore_op_name = f"{_SAVE}restore_all"
    saver.max_to_keep = 5
    saver.version = _SAVER_V2
    data: bytes = file.SerializeToString(deterministic=True)
    return data


def _with_variables(nodes: Sequence[Node], variables: Mapping[str, Array]) -> list[Node]:
    graph = [_variable(name, variables[name]) for name in sorted(variables)]
    shapes: dict[str, tuple[int, ...]] = {}
    for node in nodes:
        if node.name in variables and node.value is not None:
            shapes[node.name] = node.value.shape
            continue
        source = node.inputs[0] if node.op == "Identity" and node.inputs else ""
        if source in shapes and shapes[source] != variables[source].shape:
            # A dense layer on every pixel is a convolution in the graph: same values, two more
            # dimensions.
            shape = np.array(shapes[source], np.int32)
            graph.append(Node(f"{node.name}/shape", "Const", value=shape))
            kinds = {"T": DataType.FLOAT, "Tshape": DataType.INT32}
            graph.append(Node(node.name, "Reshape", (source, f"{node.name}/shape"), kinds))
        else:
            graph.append(node)
    return graph


def _variable(name: str, value: Array) -> Node:
    attrs: dict[str, Attr] = {
        "container": "",
        "dtype": data_type(value),
        "shape": Shape(value.shape),
        "shared_name": "",
    }
    return Node(name, "VariableV2", (), attrs)


def _add_save(graph: Any, names: Sequence[str], variables: Mapping[str, Array]) -> None:
    _add_texts(graph, "Const", ["model"], scalar=True)
    _add_texts(graph, "SaveV2/tensor_names", names)
    _add_texts(graph, "SaveV2/shape_and_slices", [""] * len(names))
    inputs = [
        f"{_SAVE}{end}" for end in ("Const", "SaveV2/tensor_names", "SaveV2/shape_and_slices")
    ]
    save = graph.node.add(name=f"{_SAVE}SaveV2", op="SaveV2", input=[*inputs, *names])
    _add_types(save, names, variables)
    done = graph.node.add(
        name=f"{_SAVE}control_dependency", op="Identity", input=[inputs[0], f"^{_SAVE}SaveV2"]
    )
    done.attr.add(key="T").value.type = _STRING


def _add_restore(graph: Any, names: Sequence[str], variables: Mapping[str, Array]) -> None:
    _add_texts(graph, "RestoreV2/tensor_names", names)
    _add_texts(graph, "RestoreV2/shape_and_slices", [""] * len(names))
    ends = ("Const", "RestoreV2/tensor_names", "RestoreV2/shape_and_slices")
    inputs = [f"{_SAVE}{end}" for end in ends]
    _add_types(
        graph.node.add(name=f"{_SAVE}RestoreV2", op="RestoreV2", input=inputs), names, variables
    )
    assigned = []
    for number, name in enumerate(names):
        read = f"{_SAVE}RestoreV2:{number}" if number else f"{_SAVE}RestoreV2"
        assign = graph.node.add(name=f"{_SAVE}Assign_{number}", op="Assign", input=[name, read])
        assign.attr.add(key="T").value.type = data_type(variables[name])
        assign.attr.add(key="use_locking").value.b = True
        assign.attr.add(key="validate_shape").value.b = True
        assigned.append(f"^{assign.name}")
    graph.node.add(name=f"{_SAVE}restore_all", op="NoOp", input=assigned)


def _add_types(node: Any, names: Sequence[str], variables: Mapping[str, Array]) -> None:
    kinds = node.attr.add(key="dtypes").value.list.type
    kinds.extend(data_type(variables[name]) for name in names)


def _add_texts(graph: Any, name: str, texts: Sequence[str], *, scalar: bool = False) -> None:
    node = graph.node.add(name=f"{_SAVE}{name}", op="Const")
    node.attr.add(key="dtype").value.type = _STRING
    tensor = node.attr.add(key="value").value.tensor
    tensor.dtype = _STRING
    tensor.tensor_shape.SetInParent()
    if not scalar:
        tensor.tensor_shape.dim.add(size=len(texts))
    tensor.string_val.extend(text.encode() for text in texts)
