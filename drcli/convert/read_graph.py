"""Reads a policy from a frozen TensorFlow graph, and proves that ours computes the same.

Layers are matched with our networks by shape. Then both compute the same pictures: if results
differ, the graph is refused.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NoReturn

import numpy as np
import torch
from numpy.typing import NDArray

from drcli.base.errors import SettingsError, shown
from drcli.convert.build_network import load_arrays
from drcli.convert.frozen_graph import LIDAR_FEATURES
from drcli.convert.tensorflow.graph import REMEDY, Array, Node, Shape, decode_graph
from drcli.convert.tensorflow.interpreter import Graph
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.encoders import MONO
from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation, PolicySpec
from drcli.model.files.sensors import CAMERAS, LIDARS, SENSORS

# Finds the layers of a policy by what operations do.
#
# Versions name layers differently, and a dense layer on every pixel is a convolution or a chain
# of reshapes. So every product with a constant kernel between input and output is a layer.


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


Weights = dict[str, NDArray[np.float32]]

TOLERANCE = 1e-4
"""Sums of thousands of products differ by 1e-6 between two libraries."""

_MOST_CHANNELS = 32
_SAC = ("/agent/policy/online/", "/sac_head_", "sac_policy_head")
_REMEDY = (
    "Name the frozen graph of a PPO model that the reference simulator or drcli wrote, such as "
    "model_30.pb."
)


@dataclass(frozen=True)
class ReadPolicy:
    """A policy from a file.

    Attributes:
        network: As in model_metadata.json.
        sensors: The camera first.
        eyes: Cameras, 1 or 2.
        scan_dims: 0 without a lidar.
        continuous: Outputs are means of a Gaussian, not probabilities.
        weights: Under our names, as far as the file has them.
        notes: For the racer.
    """

    network: str
    sensors: tuple[str, ...]
    eyes: int
    scan_dims: int
    num_actions: int
    continuous: bool
    algorithm: str
    weights: Weights
    stack: int = 1
    notes: list[str] = field(default_factory=list)

    @property
    def spec(self) -> PolicySpec:
        """Its critic sees what the policy sees."""
        return PolicySpec(
            self.num_actions,
            self.continuous,
            self.network,
            self.eyes,
            self.stack,
            self.scan_dims,
        )


def read_graph(data: bytes, origin: str) -> ReadPolicy:
    """Read a frozen graph.

    Raises:
        SettingsError: It is damaged, or cannot be trained here.
    """
    return read_nodes(decode_graph(data, origin), origin)


def read_nodes(nodes: Sequence[Node], origin: str) -> ReadPolicy:
    """Like `read_graph`."""
    if any(part in node.name for node in nodes for part in _SAC):
        refuse_sac(origin)
    graph = Graph(nodes, origin)
    sensors = _sensors(graph)
    found = find_layers(graph)
    policy = _matched(graph, sensors, found)
    _prove(nodes, graph, sensors, policy)
    return policy


def refuse_sac(origin: str) -> NoReturn:
    """The reference's has other layers."""
    raise SettingsError(
        f"{origin} is a SAC policy, which cannot be trained on: it lacks the critics and the "
        "spread of its actions, and the reference's policy has other layers than ours.",
        remedy=f"Race it as it is with `dr-evaluate --model {origin}`.",
    )


def _refuse(origin: str, what: str, remedy: str = _REMEDY) -> NoReturn:
    raise SettingsError(f"{origin} {what}.", remedy=remedy)


def _sensors(graph: Graph) -> dict[str, str]:
    found: dict[str, str] = {}
    for name in graph.inputs:
        sensor = name.rpartition("/")[2]
        if sensor not in SENSORS:
            _refuse(graph.origin, f"has the input {shown(name)}, which is not a known sensor")
        if sensor in found:
            _refuse(graph.origin, f"has two inputs for {sensor}")
        found[sensor] = name
    cameras = [sensor for sensor in found if sensor in CAMERAS]
    lidars = [sensor for sensor in found if sensor in LIDARS]
    if len(cameras) != 1 or len(lidars) > 1:
        listed = ", ".join(found) or "none"
        what = f"has the sensors {listed}, but a policy has one camera and at most one lidar"
        _refuse(graph.origin, what)
    return {sensor: found[sensor] for sensor in (*cameras, *lidars)}


def _matched(graph: Graph, sensors: Mapping[str, str], found: Trunk) -> ReadPolicy:
    camera, *lidars = sensors
    eyes = SENSORS[camera].eyes
    head = found.layers[-1:] or ()
    first = (*found.branches.get(sensors[camera], ()), *found.layers)[:1]
    if not head or first[0].kernel.ndim != 4:
        _refuse(graph.origin, "does not begin with a convolution of the camera's picture")
    channels = first[0].kernel.shape[2]
    if channels % eyes or not 0 < channels <= _MOST_CHANNELS:
        _refuse(graph.origin, f"has {channels} channels for {camera}")
    _check_shape(graph, sensors[camera], (FRAME_HEIGHT, FRAME_WIDTH, channels))
    scan_dims = 0
    if lidars:
        branch = found.branches.get(sensors[lidars[0]], ())
        if not branch:
            _refuse(graph.origin, f"has no layers for {lidars[0]}")
        scan_dims = branch[0].kernel.shape[0]
        _check_shape(graph, sensors[lidars[0]], (scan_dims,))
    policy = ReadPolicy(
        network="",
        sensors=tuple(sensors),
        eyes=eyes,
        scan_dims=scan_dims,
        num_actions=head[0].kernel.shape[-1],
        continuous=graph.output.op != "Softmax",
        algorithm="clipped_ppo",
        weights={},
        stack=channels // eyes,
    )
    order = list(found.branches)
    layers = _in_our_order(found, list(sensors.values()))
    if lidars and order[0] == sensors[lidars[0]]:
        layers = _camera_first(found, layers)
    for network in MONO:
        candidate = replace(policy, network=network)
        weights = _loaded(candidate.spec, layers)
        if weights is not None:
            return replace(candidate, weights=weights)
    shapes = ", ".join("x".join(map(str, layer.kernel.shape)) for layer in layers)
    _refuse(
        graph.origin,
        f"has a network that is not known here: its layers are {shapes}",
        f"Use a model with one of {', '.join(MONO)}, or race this one as it is with "
        f"`dr-evaluate --model {graph.origin}`.",
    )


def _check_shape(graph: Graph, name: str, wanted: tuple[int, ...]) -> None:
    shape = graph.inputs[name]
    one = Shape((1, *wanted))
    if shape and (
        len(shape) != len(one)
        or any(
            length not in (-1, expected)
            for length, expected in zip(shape[1:], one[1:], strict=True)
        )
    ):
        text = " x ".join("?" if length < 0 else str(length) for length in shape)
        need = " x ".join(map(str, wanted))
        _refuse(graph.origin, f"takes {shown(name)} of the shape {text}, not ? x {need}")


def _in_our_order(found: Trunk, inputs: Sequence[str]) -> list[Linear]:
    return [*(layer for name in inputs for layer in found.branches[name]), *found.layers]


def _camera_first(found: Trunk, layers: list[Linear]) -> list[Linear]:
    place = len(layers) - len(found.layers)
    joined = layers[place]
    rows = joined.kernel
    if rows.shape[0] <= LIDAR_FEATURES:
        return layers
    kernel = np.concatenate([rows[LIDAR_FEATURES:], rows[:LIDAR_FEATURES]])
    return [*layers[:place], Linear(kernel, joined.bias), *layers[place + 1 :]]


def _loaded(spec: PolicySpec, layers: Sequence[Linear]) -> Weights | None:
    with torch.device("meta"):
        model = ActorCritic(spec)
    shapes = {
        name.removesuffix(".weight"): tuple(tensor.shape)
        for name, tensor in model.state_dict().items()
        if name.startswith(("body.", "policy_head.")) and name.endswith(".weight")
    }
    if len(shapes) != len(layers):
        return None
    weights: Weights = {}
    for (name, shape), layer in zip(shapes.items(), layers, strict=True):
        kernel = layer.kernel
        weight = kernel.T if kernel.ndim == 2 else kernel.transpose(3, 2, 0, 1)
        if weight.shape != shape:
            return None
        weights[f"{name}.weight"] = np.array(weight, np.float32, order="C")
        weights[f"{name}.bias"] = np.array(layer.bias, np.float32)
    return weights


def _prove(
    nodes: Sequence[Node], graph: Graph, sensors: Mapping[str, str], policy: ReadPolicy
) -> None:
    """Probabilities near 0 and 1 hide differences, so values before them are compared."""
    for name, array in policy.weights.items():
        if not np.isfinite(array).all():
            _refuse(graph.origin, f"is damaged: {name} has values that are not finite")
    theirs = graph
    if graph.output.op == "Softmax":
        theirs = Graph([node for node in graph.nodes if node is not graph.output], graph.origin)
    model = ActorCritic(policy.spec).eval()
    load_arrays(model, policy.weights)
    random = np.random.default_rng(30)
    for frames in _pictures(policy.spec.channels, random):
        scans = random.random((len(frames), policy.scan_dims), dtype=np.float32)
        feeds = dict(
            zip(
                sensors.values(),
                (frames.transpose(0, 2, 3, 1).astype(np.float32), scans),
                strict=False,
            )
        )
        expected = theirs.run(feeds)
        states = np.zeros((len(frames), 0), np.float32)
        with torch.inference_mode():
            found = model(Observation.of_arrays(frames, scans, states)).policy.numpy()
        size = max(1.0, float(np.abs(expected).max(initial=0.0)))
        if expected.shape != found.shape or not (
            np.abs(expected - found).max(initial=0.0) <= TOLERANCE * size
        ):
            what = (
                f"has the layers of {policy.network} but computes something else, such as another "
                "activation or stride"
            )
            _refuse(graph.origin, what)


def _pictures(channels: int, random: np.random.Generator) -> Iterator[NDArray[np.uint8]]:
    """Noise, even grey, gradients and edges excite different parts of a network.

    Batches of shape (n, channels, 120, 160).
    """
    shape = (4, channels, FRAME_HEIGHT, FRAME_WIDTH)
    yield random.integers(0, 256, shape, np.uint8)
    rows, columns = np.mgrid[:FRAME_HEIGHT, :FRAME_WIDTH]
    edge = np.where(np.abs(columns - 80) * 2 < rows, 90, 200)  # a road to the horizon
    drawn = (rows * 2, columns, edge, np.where((rows // 12 + columns // 16) % 2, 255, 0))
    fields = np.stack([np.clip(field, 0, 255).astype(np.uint8) for field in drawn])
    yield np.repeat(fields[:, None], channels, axis=1)
    low, high = (np.full(shape[1:], value, np.uint8) for value in (0, 255))
    soft = np.clip(fields[2] + random.normal(0.0, 12.0, shape[1:]), 0, 255).astype(np.uint8)
    yield np.stack([low, high, soft, soft[:, :, ::-1]])
