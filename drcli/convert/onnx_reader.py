"""Reads an ONNX file as the nodes of a frozen graph.

Our own files come back bit for bit. Others may have channels first or last, and `Gemm` for dense
layers.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

import numpy as np

from drcli.base.errors import SettingsError, shown
from drcli.base.installation import library
from drcli.convert.onnx_graph import TO_NCHW, TO_NHWC
from drcli.convert.tensorflow.graph import Array, Attr, DataType, Node, Shape

_LARGEST = 1 << 29
_REMEDY = (
    "Use a file that `dr-export onnx` wrote; `dr-evaluate --model FILE` drives any policy in ONNX."
)


def read_onnx(data: bytes, origin: str) -> tuple[Node, ...]:
    """The graph in a file.

    Raises:
        NotAvailable: `onnx` is missing.
        SettingsError: It is damaged, or has an operation that no policy needs.
    """
    return _Reader(parse_onnx(data, origin), origin).nodes()


def parse_onnx(data: bytes, origin: str) -> Any:
    onnx = library("onnx")
    try:
        model = onnx.load_model_from_string(data)
    except Exception:  # the error of any of the libraries that parse messages
        raise SettingsError(f"{origin} is not an ONNX file.", remedy=_REMEDY) from None
    if not model.graph.node:
        raise SettingsError(f"{origin} is not an ONNX file: it has no nodes.", remedy=_REMEDY)
    tensors = [*model.graph.initializer]
    tensors += [a.t for node in model.graph.node for a in node.attribute if a.HasField("t")]
    if any(tensor.external_data for tensor in tensors):
        raise SettingsError(
            f"{origin} keeps its weights in other files.",
            remedy="Write the model with its weights inside of one file: "
            "`onnx.save(onnx.load(FILE), NEW)`.",
        )
    try:
        onnx.checker.check_model(model)
    except Exception as error:
        reason = (str(error).strip().splitlines() or ["no reason given"])[0]
        raise SettingsError(f"{origin} is damaged: {reason}", remedy=_REMEDY) from None
    return model


class _Reader:
    """Adds nodes when needed.

    Attributes:
        first: Tensors with their channels first; their nodes have them last.
        roots: Square roots, and what they are taken from.
    """

    def __init__(self, model: Any, origin: str) -> None:
        self._graph = model.graph
        self._origin = origin
        self._nodes: list[Node] = []
        self._node_of: dict[str, str] = {}
        self.first: set[str] = set()
        self.roots: dict[str, str] = {}
        self._constants: dict[str, Array] = {
            tensor.name: self._array(tensor) for tensor in self._graph.initializer
        }
        self._inputs = {
            value.name: Shape(
                dim.dim_value if dim.WhichOneof("value") == "dim_value" else -1
                for dim in value.type.tensor_type.shape.dim
            )
            for value in self._graph.input
            if value.name not in self._constants
        }

    def nodes(self) -> tuple[Node, ...]:
        for node in self._graph.node:
            if node.op_type == "Constant":
                found = [a.t for a in node.attribute if a.name == "value"]
                if not found:
                    self.refuse(node, "its value is not a tensor")
                self._constants[node.output[0]] = self._array(found[0])
            elif node.op_type in _READERS:
                _READERS[node.op_type](self, node, self.attrs(node))
            else:
                self._fail(f"has the operation {shown(node.op_type)}, which no policy needs")
        for output in self._graph.output:
            if output.name not in self._node_of:
                self._fail(f"has the output {shown(output.name)}, which nothing computes")
        return tuple(self._nodes)

    def attrs(self, node: Any) -> dict[str, Any]:
        onnx = library("onnx")
        return {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}

    def add(self, name: str, op: str, *inputs: str, attrs: Mapping[str, Attr] | None = None) -> str:
        kinds: dict[str, Attr] = {"T": DataType.FLOAT, **(attrs or {})}
        self._nodes.append(Node(name, op, inputs, kinds))
        return name

    def give(self, tensor: str, node: str, *, first: bool = False) -> None:
        self._node_of[tensor] = node
        if first:
            self.first.add(tensor)

    def plain(self, tensor: str) -> str:
        if tensor not in self.first:
            return self.any(tensor)
        name = f"{tensor}/channels_first"
        if name not in {node.name for node in self._nodes}:
            self._turn(name, self._node_of[tensor], TO_NCHW)
        return name

    def last(self, tensor: str) -> str:
        if tensor in self.first:
            return self._node_of[tensor]
        name = f"{tensor}/channels_last"
        if name not in {node.name for node in self._nodes}:
            self._turn(name, self.any(tensor), TO_NHWC)
        return name

    def any(self, tensor: str) -> str:
        if tensor in self._node_of:
            return self._node_of[tensor]
        if tensor in self._inputs:
            kind: dict[str, Attr] = {"dtype": DataType.FLOAT, "shape": self._inputs[tensor]}
            self._nodes.append(Node(tensor, "Placeholder", (), kind))
            self._node_of[tensor] = tensor
            return tensor
        value = self._constants.get(tensor)
        if value is None:
            self._fail(f"takes {shown(tensor)}, which nothing computes")
        self._node_of[tensor] = self.constant(tensor, value)
        return self._node_of[tensor]

    def constant(self, name: str, value: Array) -> str:
        if value.dtype == np.int64:
            value = value.astype(np.int32)
        self._nodes.append(Node(name, "Const", value=np.asarray(value, order="C")))
        if value.dtype != np.float32 or not value.ndim:
            return name
        return self.add(f"{name}/read", "Identity", name)

    def value(self, node: Any, place: int) -> Array:
        name = node.input[place] if place < len(node.input) else ""
        if name not in self._constants:
            self.refuse(node, f"its input {place + 1} is not constant")
        return self._constants[name]

    def is_constant(self, tensor: str) -> bool:
        return tensor in self._constants

    def refuse(self, node: Any, why: str) -> NoReturn:
        self._fail(f"cannot be read: {node.op_type} of {shown(node.output[0])}: {why}")

    def _turn(self, name: str, node: str, perm: Sequence[int]) -> None:
        order = self.constant(f"{name}/perm", np.array(perm, np.int32))
        self.add(name, "Transpose", node, order, attrs={"Tperm": DataType.INT32})

    def _array(self, tensor: Any) -> Array:
        try:
            array: Array = library("onnx").numpy_helper.to_array(tensor)
        except Exception:
            self._fail(f"is damaged: {shown(tensor.name)} is not as long as its shape")
        if array.nbytes > _LARGEST or array.dtype.kind not in "fi":
            self._fail(f"has a tensor that no policy has: {shown(tensor.name)}")
        return array.astype(np.float32) if array.dtype.kind == "f" else array

    def _fail(self, what: str) -> NoReturn:
        raise SettingsError(f"{self._origin} {what}.", remedy=_REMEDY)


def _convolution(reader: _Reader, node: Any, attrs: Mapping[str, Any]) -> None:
    result, (values, kernel, *bias) = node.output[0], node.input
    weight = reader.value(node, 1)
    if weight.ndim != 4 or attrs.get("group", 1) != 1:
        reader.refuse(node, "it is not one over pictures")
    padding = (attrs.get("auto_pad") or b"NOTSET").decode()
    if padding == "SAME_UPPER":
        padding = "SAME"
    elif padding == "VALID" or (padding == "NOTSET" and not any(attrs.get("pads", ()))):
        padding = "VALID"
    else:
        reader.refuse(node, "it has a padding that no policy has")
    picture = reader.last(values)
    read = reader.constant(kernel, weight.transpose(2, 3, 1, 0))
    name = node.name if node.name not in ("", result) else f"{result}/Conv2D"
    kinds: dict[str, Attr] = {
        "strides": (1, *attrs.get("strides", (1, 1)), 1),
        "dilations": (1, *attrs.get("dilations", (1, 1)), 1),
        "padding": padding,
        "data_format": "NHWC",
        "use_cudnn_on_gpu": True,
    }
    name = name if bias else result
    reader.add(name, "Conv2D", picture, read, attrs=kinds)
    if bias:
        reader.add(result, "BiasAdd", name, reader.any(bias[0]), attrs={"data_format": "NHWC"})
    reader.give(result, result, first=True)


def _each_value(op: str) -> Callable[[_Reader, Any, Mapping[str, Any]], None]:
    def read(reader: _Reader, node: Any, _: Mapping[str, Any]) -> None:
        result, tensor = node.output[0], node.input[0]
        name = reader.add(result, op, reader.any(tensor))
        reader.give(result, name, first=tensor in reader.first)

    return read


def _arithmetic(op: str) -> Callable[[_Reader, Any, Mapping[str, Any]], None]:
    def read(reader: _Reader, node: Any, _: Mapping[str, Any]) -> None:
        result, (left, right) = node.output[0], node.input
        first = left in reader.first and reader.is_constant(right)
        if first and reader.value(node, 1).size != 1:
            first = False
        values = reader.any(left) if first else reader.plain(left)
        other = reader.plain(right)
        is_bias = op == "Add" and reader.is_constant(right) and reader.value(node, 1).ndim == 1
        if is_bias:
            reader.add(result, "BiasAdd", values, other, attrs={"data_format": "NHWC"})
        else:
            reader.add(result, op, values, other)
        reader.give(result, result, first=first)

    return read


def _transpose(reader: _Reader, node: Any, attrs: Mapping[str, Any]) -> None:
    result, tensor = node.output[0], node.input[0]
    perm = tuple(attrs.get("perm", ()))
    if perm == TO_NCHW and tensor not in reader.first:
        reader.give(result, reader.any(tensor), first=True)
    elif perm == TO_NHWC and tensor in reader.first:
        reader.give(result, reader.any(tensor))
    elif not perm:
        reader.refuse(node, "it does not say which axes")
    else:
        values = reader.plain(tensor)
        order = reader.constant(f"{result}/perm", np.array(perm, np.int32))
        reader.add(result, "Transpose", values, order, attrs={"Tperm": DataType.INT32})
        reader.give(result, result)


def _reshape(reader: _Reader, node: Any, _: Mapping[str, Any]) -> None:
    result, (values, shape) = node.output[0], node.input
    wanted = reader.value(node, 1)
    if 0 in wanted[1:] or len(wanted) != 2 or wanted[0] not in (-1, 0, 1):
        reader.refuse(node, "its shape is not one row for each picture")
    taken = reader.plain(values)
    if wanted[0] == -1:
        name = reader.any(shape)
    else:  # TensorFlow has no 0 for "as before", and a fixed batch would be the file's only one
        name = reader.constant(f"{result}/shape", np.array([-1, *wanted[1:]], np.int32))
    reader.add(result, "Reshape", taken, name, attrs={"Tshape": DataType.INT32})
    reader.give(result, result)


def _matmul(reader: _Reader, node: Any, _: Mapping[str, Any]) -> None:
    result, (left, right) = node.output[0], node.input
    attrs: dict[str, Attr] = {"transpose_a": False, "transpose_b": False}
    reader.add(result, "MatMul", reader.plain(left), reader.plain(right), attrs=attrs)
    reader.give(result, result)


def _gemm(reader: _Reader, node: Any, attrs: Mapping[str, Any]) -> None:
    result, (left, right, *bias) = node.output[0], node.input
    if attrs.get("alpha", 1.0) != 1.0 or attrs.get("beta", 1.0) != 1.0 or attrs.get("transA"):
        reader.refuse(node, "it is not a dense layer")
    kernel = reader.value(node, 1)
    values = reader.plain(left)
    read = reader.constant(right, kernel.T if attrs.get("transB") else kernel)
    product = f"{result}/MatMul" if bias else result
    kinds: dict[str, Attr] = {"transpose_a": False, "transpose_b": False}
    reader.add(product, "MatMul", values, read, attrs=kinds)
    if bias:
        reader.add(result, "BiasAdd", product, reader.any(bias[0]), attrs={"data_format": "NHWC"})
    reader.give(result, result)


def _softmax(reader: _Reader, node: Any, attrs: Mapping[str, Any]) -> None:
    result = node.output[0]
    if attrs.get("axis", -1) not in (-1, 1):
        reader.refuse(node, "it is not over the actions")
    reader.add(result, "Softmax", reader.plain(node.input[0]))
    reader.give(result, result)


def _concat(reader: _Reader, node: Any, attrs: Mapping[str, Any]) -> None:
    result, parts = node.output[0], [reader.plain(tensor) for tensor in node.input]
    axis = reader.constant(f"{result}/axis", np.array(attrs.get("axis", 1), np.int32))
    kinds: dict[str, Attr] = {"N": len(parts), "Tidx": DataType.INT32}
    reader.add(result, "ConcatV2", *parts, axis, attrs=kinds)
    reader.give(result, result)


def _reciprocal(reader: _Reader, node: Any, _: Mapping[str, Any]) -> None:
    result, root = node.output[0], node.input[0]
    if root not in reader.roots:
        reader.refuse(node, "it is not one of a square root")
    reader.add(result, "Rsqrt", reader.plain(reader.roots[root]))
    reader.give(result, result)


def _sqrt(reader: _Reader, node: Any, _: Mapping[str, Any]) -> None:
    reader.roots[node.output[0]] = node.input[0]


_READERS: Mapping[str, Callable[[_Reader, Any, Mapping[str, Any]], None]] = {
    "Add": _arithmetic("Add"),
    "Concat": _concat,
    "Conv": _convolution,
    "Div": _arithmetic("RealDiv"),
    "Gemm": _gemm,
    "Identity": _each_value("Identity"),
    "MatMul": _matmul,
    "Mul": _arithmetic("Mul"),
    "Reciprocal": _reciprocal,
    "Relu": _each_value("Relu"),
    "Reshape": _reshape,
    "Softmax": _softmax,
    "Sqrt": _sqrt,
    "Sub": _arithmetic("Sub"),
    "Tanh": _each_value("Tanh"),
    "Transpose": _transpose,
}
