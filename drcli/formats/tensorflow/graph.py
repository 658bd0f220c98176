"""Frozen TensorFlow graphs: nodes to bytes and back."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.base.problems import shown
from drcli.formats.tensorflow.messages import DataType, GraphMessage

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
