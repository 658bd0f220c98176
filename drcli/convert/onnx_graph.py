"""Writes graphs of policies as ONNX.

Inputs are those of the frozen graph, of shape (batch, 120, 160, cameras). ONNX has channels first,
so a `Transpose` stands before and after the convolutions. Names are those of the frozen graph, so
that `onnx_reader` finds it again.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn, cast

import numpy as np

from drcli.base.errors import SettingsError, shown
from drcli.base.installation import library
from drcli.convert.tensorflow.graph import Array, Node
from drcli.convert.tensorflow.interpreter import Graph

OPSET, IR_VERSION = 13, 8
"""For engines of 2021, which cars use."""

PIXEL_RANGE = "Image.NominalPixelRange"
"""Source: ONNX's list of metadata."""
RANGE_255 = "NominalRange_0_255"

TO_NCHW, TO_NHWC = (0, 3, 1, 2), (0, 2, 3, 1)

_SAME_LAYOUT = {
    "Identity": "Identity",
    "Relu": "Relu",
    "StopGradient": "Identity",
    "Tanh": "Tanh",
}
_ARITHMETIC = {
    "Add": "Add",
    "AddV2": "Add",
    "BiasAdd": "Add",
    "Mul": "Mul",
    "RealDiv": "Div",
    "Sub": "Sub",
}


def encode_onnx(nodes: Sequence[Node], origin: str) -> bytes:
    """Equal graphs give equal bytes.

    Raises:
        NotAvailable: `onnx` is missing.
        SettingsError: The graph cannot be written.
    """
    onnx = library("onnx")
    model = _Writer(onnx, Graph(nodes, origin)).model()
    try:
        onnx.checker.check_model(model)
    except onnx.checker.ValidationError as error:
        reason = str(error).strip().splitlines()[0]
        raise SettingsError(
            f"{origin} cannot be written as ONNX: {reason}", remedy="Use another format."
        ) from None
    data: bytes = model.SerializeToString(deterministic=True)
    return data


class _Writer:
    """Results have their channels last, first, or both."""

    def __init__(self, onnx: Any, graph: Graph) -> None:
        self._onnx = onnx
        self._graph = graph
        self._by_name = {node.name: node for node in graph.nodes}
        self._nodes: list[Any] = []
        self._initializers: dict[str, Array] = {}
        self._folded = _constants(graph)
        self._last: dict[str, str] = {}
        self._first: dict[str, str] = {}
        self._uses: dict[str, list[Node]] = {}
        self._taken_over: set[str] = set()
        for node in graph.nodes:
            for name in node.inputs:
                self._uses.setdefault(name, []).append(node)

    def model(self) -> Any:
        for node in self._graph.nodes:
            if node.op == "Placeholder":
                self._last[node.name] = node.name
            elif node.name not in self._folded and node.name not in self._taken_over:
                self._write(node)
        helper, output = self._onnx.helper, self._graph.output.name
        inputs = [
            helper.make_tensor_value_info(
                name, self._onnx.TensorProto.FLOAT, ["batch" if d < 0 else d for d in shape]
            )
            for name, shape in self._graph.inputs.items()
        ]
        width = self._onnx.TensorProto.FLOAT, ["batch", self._width()]
        graph = helper.make_graph(
            self._nodes,
            "policy",
            inputs,
            [helper.make_tensor_value_info(self.last(output), *width)],
            [
                self._onnx.numpy_helper.from_array(np.asarray(array, order="C"), name)
                for name, array in self._initializers.items()
            ],
        )
        model = helper.make_model(
            graph,
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
            producer_name="drcli",
        )
        helper.set_model_props(model, {"Image.BitmapPixelFormat": "Gray8", PIXEL_RANGE: RANGE_255})
        return model

    def last(self, name: str) -> str:
        if name in self._folded:
            return self.initializer(self._variable(name), self._folded[name])
        if name not in self._last:
            tensor = self._first[name]
            self._last[name] = self.add("Transpose", f"{name}/NHWC", tensor, perm=TO_NHWC)
        return self._last[name]

    def first(self, name: str) -> str:
        if name not in self._first:
            tensor = self.last(name)
            self._first[name] = self.add("Transpose", f"{name}/NCHW", tensor, perm=TO_NCHW)
        return self._first[name]

    def tensors(self, node: Node) -> list[str]:
        return [self.last(name) for name in node.inputs]

    def initializer(self, name: str, array: Array) -> str:
        """Whole numbers become int64, as ONNX wants."""
        if array.dtype == np.int32:
            array = array.astype(np.int64)
        if self._initializers.setdefault(name, array).shape != array.shape:
            name = f"{name}/as_stored"  # a kernel that something other than a convolution takes too
            self._initializers[name] = array
        return name

    def add(self, op: str, result: str, *inputs: str, name: str = "", **attrs: Any) -> str:
        node = self._onnx.helper.make_node(op, inputs, [result], name=name or result, **attrs)
        self._nodes.append(node)
        return result

    def _write(self, node: Node) -> None:
        name, inputs = node.name, node.inputs
        if node.op == "Conv2D":
            self._convolution(node)
        elif node.op in _SAME_LAYOUT:
            known = self._first if inputs[0] in self._first else self._last
            known[name] = self.add(_SAME_LAYOUT[node.op], name, known[inputs[0]])
        elif node.op in _ARITHMETIC:
            self._last[name] = self.add(_ARITHMETIC[node.op], name, *map(self.last, inputs))
        elif node.op in _OTHERS:
            self._last[name] = _OTHERS[node.op](self, node)
        else:
            self.refuse(node, "ONNX has no such operation here")

    def _convolution(self, node: Node) -> None:
        values, kernel = node.inputs
        if kernel not in self._folded:
            self.refuse(node, "its kernel is not constant")
        strides, dilations = (
            cast(tuple[int, ...], node.attrs.get(key, (1, 1, 1, 1)))[1:3]
            for key in ("strides", "dilations")
        )
        padding = {"VALID": "VALID", "SAME": "SAME_UPPER"}.get(str(node.attrs.get("padding")))
        if padding is None:
            self.refuse(node, "its padding is unknown")
        weight = np.ascontiguousarray(self._folded[kernel].transpose(3, 2, 0, 1))
        inputs = [self.first(values), self.initializer(self._variable(kernel), weight)]
        result = node.name
        uses = self._uses.get(node.name, [])
        if len(uses) == 1 and uses[0].op == "BiasAdd" and uses[0].inputs[1] in self._folded:
            bias = uses[0].inputs[1]
            inputs.append(self.initializer(self._variable(bias), self._folded[bias]))
            result = uses[0].name
            self._taken_over.add(result)
        self._first[result] = self.add(
            "Conv",
            result,
            *inputs,
            name=node.name,
            strides=strides,
            dilations=dilations,
            auto_pad=padding,
        )

    def _variable(self, name: str) -> str:
        read = self._by_name[name]
        return read.inputs[0] if read.op == "Identity" else name

    def folded(self, node: Node, place: int) -> Array:
        name = node.inputs[place]
        if name not in self._folded:
            self.refuse(node, f"{shown(name)} is not constant")
        return self._folded[name]

    def _width(self) -> int:
        feeds = {
            name: np.zeros([1, *(max(1, d) for d in shape[1:])], np.float32)
            for name, shape in self._graph.inputs.items()
        }
        result = self._graph.run(feeds)
        if result.ndim != 2:
            self.refuse(self._graph.output, "the output is not one row for each picture")
        return int(result.shape[1])

    def refuse(self, node: Node, why: str) -> NoReturn:
        raise SettingsError(
            f"{self._graph.origin} cannot be written as ONNX: {node.op} of {shown(node.name)}: "
            f"{why}.",
            remedy="Use the graph itself (--runtime pb), or import the model with `dr-import` and "
            "export it again.",
        )


def _constants(graph: Graph) -> dict[str, Array]:
    """Weights under all their names."""
    found: dict[str, Array] = {}
    for node in graph.nodes:
        if node.value is not None:
            found[node.name] = node.value
        elif node.inputs and all(name in found for name in node.inputs):
            parts = [Node(name, "Const", value=found[name]) for name in dict.fromkeys(node.inputs)]
            found[node.name] = Graph([*parts, node], graph.origin).run({})
    return found


def _matmul(writer: _Writer, node: Node) -> str:
    turned = []
    for tensor, key in zip(writer.tensors(node), ("transpose_a", "transpose_b"), strict=True):
        if node.attrs.get(key):
            tensor = writer.add("Transpose", f"{node.name}/{key}", tensor, perm=(1, 0))
        turned.append(tensor)
    return writer.add("MatMul", node.name, *turned)


def _concat(writer: _Writer, node: Node) -> str:
    axis = int(writer.folded(node, -1))
    return writer.add("Concat", node.name, *map(writer.last, node.inputs[:-1]), axis=axis)


def _rsqrt(writer: _Writer, node: Node) -> str:
    root = writer.add("Sqrt", f"{node.name}/sqrt", *writer.tensors(node))
    return writer.add("Reciprocal", node.name, root)


def _pack(writer: _Writer, node: Node) -> str:
    axis = int(cast(int, node.attrs.get("axis", 0)))
    axes = writer.initializer(f"{node.name}/axes", np.array([axis]))
    parts = [
        writer.add("Unsqueeze", f"{node.name}/unsqueezed_{number}", tensor, axes)
        for number, tensor in enumerate(writer.tensors(node))
    ]
    return writer.add("Concat", node.name, *parts, axis=axis)


def _strided_slice(writer: _Writer, node: Node) -> str:
    begin, end, step = (writer.folded(node, k).astype(np.int64) for k in (1, 2, 3))
    if node.attrs.get("ellipsis_mask") or node.attrs.get("new_axis_mask") or (step < 1).any():
        writer.refuse(node, "it is no simple slice")
    shrink, no_begin, no_end = (
        int(cast(int, node.attrs.get(key, 0)))
        for key in ("shrink_axis_mask", "begin_mask", "end_mask")
    )
    largest = np.iinfo(np.int64).max
    begins, ends, shrunk = begin.copy(), end.copy(), []
    for axis in range(len(begin)):
        if shrink >> axis & 1:
            ends[axis] = begins[axis] + 1 or largest
            shrunk.append(axis)
            continue
        begins[axis] = 0 if no_begin >> axis & 1 else begins[axis]
        ends[axis] = largest if no_end >> axis & 1 else ends[axis]
    bounds = (("begin", begins), ("end", ends), ("axes", np.arange(len(begin))), ("step", step))
    names = [writer.initializer(f"{node.name}/{part}", value) for part, value in bounds]
    if not shrunk:
        return writer.add("Slice", node.name, writer.last(node.inputs[0]), *names)
    part = writer.add("Slice", f"{node.name}/slice", writer.last(node.inputs[0]), *names)
    axes = writer.initializer(f"{node.name}/shrunk", np.array(shrunk))
    return writer.add("Squeeze", node.name, part, axes)


def _prod(writer: _Writer, node: Node) -> str:
    axes = np.atleast_1d(writer.folded(node, 1)).tolist()
    return writer.add("ReduceProd", node.name, writer.last(node.inputs[0]), axes=axes, keepdims=0)


def _gather(writer: _Writer, node: Node) -> str:
    return writer.add(
        "Gather", node.name, *map(writer.last, node.inputs[:2]), axis=int(writer.folded(node, 2))
    )


def _transpose(writer: _Writer, node: Node) -> str:
    perm = writer.folded(node, 1).tolist()
    return writer.add("Transpose", node.name, writer.last(node.inputs[0]), perm=perm)


_OTHERS: Mapping[str, Callable[[_Writer, Node], str]] = {
    "ConcatV2": _concat,
    "GatherV2": _gather,
    "MatMul": _matmul,
    "Pack": _pack,
    "Prod": _prod,
    "Reshape": lambda writer, node: writer.add("Reshape", node.name, *writer.tensors(node)),
    "Rsqrt": _rsqrt,
    "Shape": lambda writer, node: writer.add("Shape", node.name, *writer.tensors(node)),
    "Softmax": lambda writer, node: writer.add(
        "Softmax", node.name, *writer.tensors(node), axis=-1
    ),
    "StridedSlice": _strided_slice,
    "Transpose": _transpose,
}
