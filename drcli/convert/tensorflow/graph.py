"""Frozen TensorFlow graphs: nodes to bytes and back."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NoReturn

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from drcli.base.errors import SettingsError, shown

# TensorFlow's protobuf messages, as far as needed; other fields are skipped.
#
# Source: TensorFlow's `graph.proto`, `node_def.proto`, `attr_value.proto`, `tensor.proto`,
# `tensor_shape.proto`, `versions.proto`, `meta_graph.proto`, `saver.proto`,
# `tensor_bundle.proto`.


_PACKAGE = "drcli.tensorflow"
_SCALARS = descriptor_pb2.FieldDescriptorProto

_TYPES = {
    "bool": _SCALARS.TYPE_BOOL,
    "bytes": _SCALARS.TYPE_BYTES,
    "double": _SCALARS.TYPE_DOUBLE,
    "fixed32": _SCALARS.TYPE_FIXED32,
    "float": _SCALARS.TYPE_FLOAT,
    "int32": _SCALARS.TYPE_INT32,
    "int64": _SCALARS.TYPE_INT64,
    "string": _SCALARS.TYPE_STRING,
}

_FIELDS: dict[str, tuple[str, ...]] = {
    "Dim": ("1 size int64", "2 name string"),
    "TensorShape": ("2 dim *Dim", "3 unknown_rank bool"),
    "Tensor": (
        "1 dtype int32",
        "2 tensor_shape TensorShape",
        "3 version_number int32",
        "4 tensor_content bytes",
        "5 float_val *float",
        "6 double_val *double",
        "7 int_val *int32",
        "8 string_val *bytes",
        "10 int64_val *int64",
        "13 half_val *int32",
    ),
    "ListValue": ("2 s *bytes", "3 i *int64", "4 f *float", "5 b *bool", "6 type *int32"),
    "AttrValue": (
        "1 list ListValue",
        "2 s bytes",
        "3 i int64",
        "4 f float",
        "5 b bool",
        "6 type int32",
        "7 shape TensorShape",
        "8 tensor Tensor",
    ),
    "Attr": ("1 key string", "2 value AttrValue"),
    "Node": ("1 name string", "2 op string", "3 input *string", "4 device string", "5 attr *Attr"),
    "Versions": ("1 producer int32", "2 min_consumer int32"),
    "Graph": ("1 node *Node", "4 versions Versions"),
    "MetaInfo": ("4 tags *string", "5 tensorflow_version string"),
    "Saver": (
        "1 filename_tensor_name string",
        "2 save_tensor_name string",
        "3 restore_op_name string",
        "4 max_to_keep int32",
        "5 sharded bool",
        "7 version int32",
    ),
    "MetaGraph": ("1 meta_info_def MetaInfo", "2 graph_def Graph", "3 saver_def Saver"),
    "BundleHeader": ("1 num_shards int32", "2 endianness int32", "3 version Versions"),
    "Extent": ("1 start int64", "2 length int64"),
    "Slice": ("1 extent *Extent",),
    "BundleEntry": (
        "1 dtype int32",
        "2 shape TensorShape",
        "3 shard_id int32",
        "4 offset int64",
        "5 size int64",
        "6 crc32c fixed32",
        "7 slices *Slice",
    ),
}
"""`*`: repeated. A node's attributes are a map in TensorFlow, which protobuf writes like repeated
pairs.
"""

_CHOICES = {"AttrValue": "value"}


class DataType(IntEnum):
    """Source: TensorFlow's `types.proto`."""

    FLOAT = 1
    DOUBLE = 2
    INT32 = 3
    INT64 = 9
    HALF = 19


def _message(name: str, fields: tuple[str, ...]) -> descriptor_pb2.DescriptorProto:
    message = descriptor_pb2.DescriptorProto(name=name)
    if name in _CHOICES:
        message.oneof_decl.add(name=_CHOICES[name])
    for written in fields:
        number, field_name, kind = written.split()
        field = message.field.add(name=field_name, number=int(number))
        repeated, kind = kind.startswith("*"), kind.lstrip("*")
        field.label = _SCALARS.LABEL_REPEATED if repeated else _SCALARS.LABEL_OPTIONAL
        if kind in _TYPES:
            field.type = _TYPES[kind]
        else:
            field.type, field.type_name = _SCALARS.TYPE_MESSAGE, f".{_PACKAGE}.{kind}"
        if name in _CHOICES:
            field.oneof_index = 0
    return message


def _classes() -> dict[str, Any]:
    file = descriptor_pb2.FileDescriptorProto(
        name="drcli/tensorflow.proto",
        package=_PACKAGE,
        syntax="proto3",
        message_type=[_message(name, fields) for name, fields in _FIELDS.items()],
    )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}"))
        for name in _FIELDS
    }


_messages = _classes()

AttrValueMessage: Any = _messages["AttrValue"]
BundleEntryMessage: Any = _messages["BundleEntry"]
BundleHeaderMessage: Any = _messages["BundleHeader"]
GraphMessage: Any = _messages["Graph"]
MetaGraphMessage: Any = _messages["MetaGraph"]
TensorMessage: Any = _messages["Tensor"]
TensorShapeMessage: Any = _messages["TensorShape"]


Array = NDArray[Any]

_DTYPES: dict[DataType, np.dtype[Any]] = {
    DataType.FLOAT: np.dtype("<f4"),
    DataType.DOUBLE: np.dtype("<f8"),
    DataType.INT32: np.dtype("<i4"),
    DataType.INT64: np.dtype("<i8"),
    DataType.HALF: np.dtype("<f2"),
}

_LARGEST = 1 << 27
"""512 MB. The reference's largest has 57 million values."""

_PRODUCER = 27
"""Of TensorFlow 1.12, the reference's."""

REMEDY = "Use a graph that the reference simulator or `dr-export pb` wrote."


class Shape(tuple[int, ...]):
    """-1 for a length that is not fixed."""


Attr = bool | int | float | str | tuple[int, ...] | Shape | DataType


@dataclass(frozen=True, eq=False)
class Node:
    """`attrs` lack what the interpreter and the converters ignore; `value` is that of a `Const`."""

    name: str
    op: str
    inputs: tuple[str, ...] = ()
    attrs: Mapping[str, Attr] = field(default_factory=dict)
    value: Array | None = None


def encode_graph(nodes: Sequence[Node]) -> bytes:
    graph = graph_message(nodes)
    data: bytes = graph.SerializeToString(deterministic=True)
    return data


def graph_message(nodes: Sequence[Node]) -> Any:
    graph = GraphMessage()
    graph.versions.producer = _PRODUCER
    for node in nodes:
        written = graph.node.add(name=node.name, op=node.op, input=node.inputs)
        for name, value in sorted(node.attrs.items()):
            _write_attr(written.attr.add(key=name).value, value)
        if node.value is not None:
            attr = written.attr.add(key="dtype").value
            attr.type = data_type(node.value)
            _write_tensor(written.attr.add(key="value").value.tensor, node.value)
    return graph


def decode_graph(data: bytes, origin: str) -> tuple[Node, ...]:
    """SettingsError if it is not a graph, or a tensor is wrong."""
    graph = GraphMessage()
    try:
        graph.ParseFromString(data)
    except (DecodeError, ValueError, RecursionError):
        _refuse(origin, "is not a TensorFlow graph")
    if not graph.node:
        _refuse(origin, "is not a TensorFlow graph: it has no nodes")
    return tuple(_read_node(node, origin) for node in graph.node)


def data_type(array: Array) -> DataType:
    """ValueError if TensorFlow has none."""
    for kind, dtype in _DTYPES.items():
        if array.dtype == dtype:
            return kind
    raise ValueError(f"Tensors of {array.dtype} cannot be written.")


def dtype_of(number: int) -> np.dtype[Any] | None:
    """None if no model of the reference has it."""
    try:
        return _DTYPES[DataType(number)]
    except ValueError:
        return None


def shape_of(message: Any) -> Shape:
    return Shape(dim.size for dim in message.dim)


def _read_node(node: Any, origin: str) -> Node:
    attrs: dict[str, Attr] = {}
    value: Array | None = None
    for attr in node.attr:
        kind = attr.value.WhichOneof("value")
        if kind == "tensor":
            value = _read_tensor(attr.value.tensor, node.name, origin)
        elif kind is not None:
            found = _read_attr(attr.value, kind)
            if found is not None and attr.key != "dtype":
                attrs[attr.key] = found
    if node.op == "Placeholder":
        attrs["dtype"] = DataType.FLOAT
    if node.op == "Const" and value is None:
        _refuse(origin, f"is damaged: {shown(node.name)} has no value")
    inputs = tuple(name.removesuffix(":0") for name in node.input if not name.startswith("^"))
    return Node(node.name, node.op, inputs, attrs, value)


def _read_attr(value: Any, kind: str) -> Attr | None:
    if kind == "s":
        return str(value.s.decode("utf-8", "replace"))
    if kind == "list":
        return tuple(value.list.i) if value.list.i else None
    if kind == "shape":
        return shape_of(value.shape)
    if kind == "type":
        return DataType(value.type) if value.type in iter(DataType) else None
    number: int | float | bool = getattr(value, kind)
    return number


def _read_tensor(tensor: Any, name: str, origin: str) -> Array:
    dtype = dtype_of(tensor.dtype)
    shape = shape_of(tensor.tensor_shape)
    if dtype is None:
        _refuse(origin, f"has a tensor of an unknown type ({tensor.dtype}): {shown(name)}")
    count = math.prod(shape)
    if min(shape, default=0) < 0 or count > _LARGEST:
        _refuse(origin, f"is damaged: {shown(name)} has the shape {list(shape)}")
    if tensor.tensor_content:
        if len(tensor.tensor_content) != count * dtype.itemsize:
            _refuse(origin, f"is damaged: {shown(name)} is not as long as its shape {list(shape)}")
        return np.frombuffer(tensor.tensor_content, dtype).reshape(shape)
    values = _listed_values(tensor, dtype)
    if not len(values):
        return np.zeros(shape, dtype)
    if len(values) > count:
        _refuse(origin, f"is damaged: {shown(name)} is longer than its shape {list(shape)}")
    # TensorFlow leaves out repetitions of the last value.
    filled = np.full(count, values[-1], dtype)
    filled[: len(values)] = values
    return filled.reshape(shape)


def _listed_values(tensor: Any, dtype: np.dtype[Any]) -> Array:
    if tensor.half_val:
        return np.array(tensor.half_val, np.uint16).view(np.float16)
    lists = (tensor.float_val, tensor.double_val, tensor.int_val, tensor.int64_val)
    return np.array(next((list(values) for values in lists if values), []), dtype)


def _write_attr(message: Any, value: Attr) -> None:
    match value:
        case DataType():
            message.type = value
        case Shape():
            message.shape.SetInParent()  # also for a single value, which has no dimensions
            for size in value:
                message.shape.dim.add(size=size)
        case tuple():
            message.list.i.extend(value)
        case str():
            message.s = value.encode()
        case bool():
            message.b = value
        case int():
            message.i = value
        case float():
            message.f = value


def _write_tensor(message: Any, array: Array) -> None:
    message.dtype = data_type(array)
    for size in array.shape:
        message.tensor_shape.dim.add(size=size)
    if array.ndim:
        message.tensor_content = np.ascontiguousarray(array).tobytes()
    elif array.dtype == np.float32:
        message.float_val.append(float(array))
    else:
        message.int_val.append(int(array))


def _refuse(origin: str, what: str) -> NoReturn:
    raise SettingsError(f"{origin} {what}.", remedy=REMEDY)


# The `.meta` file of a checkpoint: a graph with variables, for `import_meta_graph`.
#
# The reference simulator never reads it, but importers ask for it.


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
