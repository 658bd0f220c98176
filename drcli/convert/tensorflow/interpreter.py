"""Runs frozen graphs with NumPy.

It refuses operations that neither the reference's policies nor ours have.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn, cast

import numpy as np

from drcli.base.errors import SettingsError, shown
from drcli.convert.tensorflow.graph import REMEDY, Array, Node, Shape

_MOST_BYTES = 1 << 29
"""Of one result. The reference's largest kernel takes 229 MB, 100 frames in its widest layer 240
MB.
"""

_UNFIT = (ValueError, TypeError, IndexError, KeyError, NotImplementedError, MemoryError)


class Graph:
    """A graph in an order in which it can run, with those `nodes` that the output needs."""

    def __init__(self, nodes: Sequence[Node], origin: str) -> None:
        """SettingsError if it has an unknown operation, or no single output."""
        self.origin = origin
        by_name = {node.name: node for node in nodes}
        if len(by_name) != len(nodes):
            self._refuse("has two nodes of one name")
        taken = {name for node in nodes for name in node.inputs}
        sinks = [node for node in nodes if node.name not in taken]
        if missing := sorted(taken - set(by_name)):
            self._refuse(f"takes the result of {shown(missing[0])}, which it does not have")
        unknown = sorted({node.op for node in nodes} - set(_OPERATIONS) - {"Placeholder", "Const"})
        if unknown:
            self._refuse(f"has the operation {shown(unknown[0])}, which no policy needs")
        if len(sinks) != 1:
            self._refuse(f"has {len(sinks)} outputs instead of one")
        self.output = sinks[0]
        self.nodes = self._in_order(by_name)
        needed = {node.name for node in self.nodes}
        self.inputs = {
            node.name: cast(Shape, node.attrs.get("shape", Shape()))
            for node in nodes
            if node.op == "Placeholder" and node.name in needed
        }
        self._last_use = {
            name: number for number, node in enumerate(self.nodes) for name in node.inputs
        }

    def run(self, inputs: Mapping[str, Array]) -> Array:
        """SettingsError if shapes do not fit. Arrays begin with the number of samples."""
        results: dict[str, Array] = {}
        for number, node in enumerate(self.nodes):
            if node.op == "Placeholder":
                results[node.name] = inputs[node.name]
            elif node.value is not None:
                results[node.name] = node.value
            else:
                arguments = [results[name] for name in node.inputs]
                try:
                    results[node.name] = _OPERATIONS[node.op](node, *arguments)
                except _UNFIT as error:
                    self._refuse(f"cannot be computed: {node.op} of {shown(node.name)}: {error}")
                if results[node.name].nbytes > _MOST_BYTES:
                    self._refuse(f"grows too large at {shown(node.name)}")
            for name in node.inputs:
                if self._last_use[name] == number:  # large results are freed early
                    results.pop(name, None)
        return results[self.output.name]

    def _in_order(self, by_name: Mapping[str, Node]) -> tuple[Node, ...]:
        """Inputs first; without recursion, for long graphs."""
        order: list[Node] = []
        done: set[str] = set()
        open_: set[str] = set()
        stack = [(self.output, False)]
        while stack:
            node, complete = stack.pop()
            if complete:
                open_.discard(node.name)
                done.add(node.name)
                order.append(node)
            elif node.name in open_:
                self._refuse(f"goes round in a circle at {shown(node.name)}")
            elif node.name not in done:
                open_.add(node.name)
                stack.append((node, True))
                stack += [(by_name[name], False) for name in reversed(node.inputs)]
        return tuple(order)

    def _refuse(self, what: str) -> NoReturn:
        raise SettingsError(f"{self.origin} {what}.", remedy=REMEDY)


def _conv2d(node: Node, images: Array, kernel: Array) -> Array:
    _require(node, padding="VALID", data_format="NHWC", dilations=(1, 1, 1, 1))
    _, down, right, _ = cast(tuple[int, ...], node.attrs["strides"])
    rows, columns, channels, filters = kernel.shape
    if images.shape[3] != channels:
        raise ValueError(f"{images.shape[3]} channels, and a kernel for {channels}")
    windows = np.lib.stride_tricks.sliding_window_view(images, (rows, columns), axis=(1, 2))
    windows = windows[:, ::down, ::right].transpose(0, 1, 2, 4, 5, 3)
    shape = windows.shape[:3]
    flat = windows.reshape(-1, rows * columns * channels)
    return (flat @ kernel.reshape(-1, filters)).reshape(*shape, filters)


def _bias_add(node: Node, values: Array, bias: Array) -> Array:
    _require(node, data_format="NHWC")
    if bias.shape != values.shape[-1:]:
        raise ValueError(f"{bias.size} biases for {values.shape[-1]} channels")
    return values + bias


def _matmul(node: Node, left: Array, right: Array) -> Array:
    left = left.T if node.attrs.get("transpose_a") else left
    right = right.T if node.attrs.get("transpose_b") else right
    if left.ndim != 2 or right.ndim != 2:
        raise ValueError("not two matrices")
    return left @ right


def _reshape(node: Node, values: Array, shape: Array) -> Array:
    wanted = shape.tolist()
    if values.size == 0 and wanted == [0, -1]:
        wanted = [0, math.prod(values.shape[1:])]  # NumPy cannot tell a length of nothing
    return values.reshape(wanted)


def _softmax(node: Node, logits: Array) -> Array:
    powers = np.exp(logits - logits.max(axis=-1, keepdims=True))
    shares: Array = powers / powers.sum(axis=-1, keepdims=True)
    return shares


def _concat(node: Node, *arguments: Array) -> Array:
    *parts, axis = arguments
    return np.concatenate(parts, axis=int(axis))


def _strided_slice(node: Node, values: Array, begin: Array, end: Array, step: Array) -> Array:
    _require(node, ellipsis_mask=0, new_axis_mask=0)
    shrink, begins, ends = (
        int(cast(int, node.attrs.get(name, 0)))
        for name in ("shrink_axis_mask", "begin_mask", "end_mask")
    )
    index: list[int | slice] = []
    for axis, (first, last, by) in enumerate(zip(begin, end, step, strict=True)):
        if shrink >> axis & 1:
            index.append(int(first))
            continue
        low = None if begins >> axis & 1 else int(first)
        high = None if ends >> axis & 1 else int(last)
        index.append(slice(low, high, int(by)))
    return values[tuple(index)]


def _pack(node: Node, *parts: Array) -> Array:
    return np.stack(parts, axis=int(cast(int, node.attrs.get("axis", 0))))


def _require(node: Node, **wanted: object) -> None:
    for name, value in wanted.items():
        if node.attrs.get(name, value) != value:
            raise NotImplementedError(f"{name} is {node.attrs[name]}, not {value}")


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "Add": lambda node, a, b: a + b,
    "AddV2": lambda node, a, b: a + b,
    "BiasAdd": _bias_add,
    "ConcatV2": _concat,
    "Conv2D": _conv2d,
    "GatherV2": lambda node, a, indices, axis: np.take(a, indices, axis=int(axis)),
    "Identity": lambda node, a: a,
    "MatMul": _matmul,
    "Mul": lambda node, a, b: a * b,
    "Pack": _pack,
    "Prod": lambda node, a, axis: a.prod(axis=tuple(np.atleast_1d(axis).tolist()), dtype=a.dtype),
    "RealDiv": lambda node, a, b: a / b,
    "Relu": lambda node, a: np.maximum(a, 0),
    "Reshape": _reshape,
    "Rsqrt": lambda node, a: 1.0 / np.sqrt(a),
    "Shape": lambda node, a: np.array(a.shape, np.int32),
    "Softmax": _softmax,
    "StopGradient": lambda node, a: a,
    "StridedSlice": _strided_slice,
    "Sub": lambda node, a, b: a - b,
    "Tanh": lambda node, a: np.tanh(a),
    "Transpose": lambda node, a, order: a.transpose(order.tolist()),
}
