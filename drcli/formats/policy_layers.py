"""Finds the layers of a policy by what operations do.

Versions name layers differently, and a dense layer on every pixel is a convolution or a chain of
reshapes. So every product with a constant kernel between input and output is a layer.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.base.problems import shown
from drcli.formats.tensorflow.graph import REMEDY, Array, Node
from drcli.formats.tensorflow.interpreter import Graph

Floats = NDArray[np.float32]

_PASSING = ("Identity", "Pack", "Reshape", "StopGradient", "StridedSlice", "Transpose")
_AFFINE = ("Add", "AddV2", "BiasAdd", "Mul", "RealDiv", "Sub")
_TWO_INPUTS = ("Conv2D", "MatMul", *_AFFINE)


@dataclass(frozen=True, eq=False)
class Linear:
    """A convolution, or a dense layer.

    Attributes:
        kernel: Shape (rows, columns, channels, filters) or (inputs, outputs); a convolution of one
            pixel is a dense layer.
        bias: Shape (filters,) or (outputs,).
    """

    kernel: Floats
    bias: Floats


@dataclass(frozen=True, eq=False)
class Trunk:
    """`branches` on each input in the order of joining (empty for one input), then `layers`."""

    branches: Mapping[str, tuple[Linear, ...]]
    layers: tuple[Linear, ...]


@dataclass(frozen=True, eq=False)
class _Path:
    """`is_open` while a constant still belongs to a layer."""

    branches: Mapping[str, tuple[Linear, ...]]
    layers: tuple[Linear, ...] = ()
    is_open: bool = False

    def same_as(self, other: "_Path") -> bool:
        return self.layers == other.layers and self.branches == other.branches


def find_layers(graph: Graph) -> Trunk:
    """SettingsError if it is not a chain of convolutions and dense layers."""
    finder = _Finder(graph)
    path = finder.paths.get(graph.output.name)
    if path is None:
        finder.refuse("has an output that does not depend on a picture")
    return Trunk(path.branches, path.layers)


class _Finder:
    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._by_name = {node.name: node for node in graph.nodes}
        self._constant: set[str] = set()
        self.paths: dict[str, _Path] = {}
        for node in graph.nodes:
            if node.op == "Placeholder":
                self.paths[node.name] = _Path({node.name: ()})
            elif all(name in self._constant for name in node.inputs) and node.op != "Shape":
                self._constant.add(node.name)
            elif (path := self._path(node)) is not None:
                self.paths[node.name] = path

    def refuse(self, what: str) -> NoReturn:
        raise SettingsError(f"{self._graph.origin} {what}.", remedy=REMEDY)

    def _path(self, node: Node) -> _Path | None:
        before = [self.paths[name] for name in node.inputs if name in self.paths]
        if node.op == "Shape" or not before:
            return None
        first = before[0]
        if node.op in _TWO_INPUTS and len(node.inputs) != 2:
            self.refuse(f"is damaged: {node.op} at {shown(node.name)} does not take two values")
        if node.op == "ConcatV2" and len(before) > 1:
            return self._joined(node, before)
        if (
            node.op in ("Add", "AddV2")
            and len(before) > 1
            and all(path.same_as(first) for path in before[1:])
        ):
            # The reference adds the features to themselves, once with the weight 0.
            return replace(first, is_open=False)
        if len(before) == 1:
            if node.op in ("Conv2D", "MatMul") and node.inputs[1] in self._constant:
                return replace(first, layers=(*first.layers, self._linear(node)), is_open=True)
            if node.op in _AFFINE:
                return self._affine(node, first)
            if node.op in _PASSING:
                return first
            if node.op in ("Relu", "Softmax"):
                return replace(first, is_open=False)
        return self.refuse(
            f"is no policy that can be trained here: it has {node.op} at {shown(node.name)} where "
            "a network of the reference has only convolutions and dense layers"
        )

    def _joined(self, node: Node, parts: list[_Path]) -> _Path:
        names = [name for part in parts for name in part.branches]
        if len(set(names)) < len(names) or any(len(part.branches) > 1 for part in parts):
            self.refuse(f"joins the same sensor twice at {shown(node.name)}")
        return _Path({next(iter(part.branches)): part.layers for part in parts})

    def _linear(self, node: Node) -> Linear:
        kernel = self._value(node.inputs[1])
        if kernel.ndim != (4 if node.op == "Conv2D" else 2):
            self.refuse(f"has a kernel of the shape {list(kernel.shape)} at {shown(node.name)}")
        if node.op == "MatMul" and node.attrs.get("transpose_b"):
            kernel = kernel.T
        if node.op == "Conv2D" and kernel.shape[:2] == (1, 1):
            kernel = kernel[0, 0]
        bias = np.zeros(kernel.shape[-1], np.float32)
        return Linear(np.asarray(kernel, np.float32), bias)

    def _affine(self, node: Node, path: _Path) -> _Path:
        """A constant, part of the layer before it, if it follows one.

        Otherwise it is left out; comparing whole networks shows whether that is right.
        """
        if not path.is_open:
            return path
        left, right = node.inputs
        constant = self._value(right if right in self._constant else left)
        *others, last = path.layers
        width = last.bias.shape[0]
        if constant.size not in (1, width):
            self.refuse(f"has {constant.size} values for {width} channels at {shown(node.name)}")
        values = np.broadcast_to(constant.reshape(-1), (width,))
        if node.op == "BiasAdd" and not last.bias.any():
            folded = Linear(last.kernel, np.asarray(values, np.float32))  # bit for bit
        else:
            folded = self._folded(node, last, values.astype(np.float64), left in self._constant)
        return replace(path, layers=(*others, folded))

    def _folded(self, node: Node, layer: Linear, values: Array, is_first: bool) -> Linear:
        kernel, bias = layer.kernel.astype(np.float64), layer.bias.astype(np.float64)
        if node.op in ("Add", "AddV2", "BiasAdd"):
            bias = bias + values
        elif node.op == "Mul":
            kernel, bias = kernel * values, bias * values
        elif is_first:
            if node.op == "RealDiv":
                self.refuse(f"divides by the result of a layer at {shown(node.name)}")
            kernel, bias = -kernel, values - bias
        elif node.op == "Sub":
            bias = bias - values
        else:
            kernel, bias = kernel / values, bias / values
        return Linear(kernel.astype(np.float32), bias.astype(np.float32))

    def _value(self, name: str) -> Array:
        needed: dict[str, Node] = {}
        stack = [name]
        while stack:
            node = self._by_name[stack.pop()]
            if node.op == "Placeholder":
                self.refuse(f"is damaged: {shown(name)} is no constant")
            if node.name not in needed:
                needed[node.name] = node
                stack += node.inputs
        return Graph(list(needed.values()), self._graph.origin).run({})
