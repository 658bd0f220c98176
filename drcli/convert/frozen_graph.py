"""Writes a policy as a frozen TensorFlow graph."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.convert.reference_names import (
    POLICY,
    POLICY_BODY,
    PPO_AGENT,
    SAC_AGENT,
    Embedder,
    Layer,
    embedders,
    input_name,
    middleware,
    policy_head,
)
from drcli.convert.tensorflow.graph import (
    Array,
    Attr,
    DataType,
    Node,
    Shape,
    decode_graph,
    encode_graph,
)
from drcli.convert.tensorflow.interpreter import Graph
from drcli.learn.encoders import Network
from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation, PolicySpec
from drcli.model.files.sensors import LIDARS

Weights = Mapping[str, NDArray[np.float32]]
LIDAR_FEATURES = 256
_NORM_EPSILON = 1e-5
"""As in torch's LayerNorm."""


def encode_policy(weights: Weights, spec: PolicySpec, sensors: Sequence[str]) -> bytes:
    return encode_graph(policy_nodes(weights, spec, sensors))


def policy_nodes(weights: Weights, spec: PolicySpec, sensors: Sequence[str]) -> list[Node]:
    """The graph of a policy.

    Takes grey values from 0 to 255 of shape (n, 120, 160, cameras), and a lidar's. Gives
    probabilities, or continuous actions, nominally in [-1, 1], of shape (n, num_actions). SAC's are
    squashed by tanh, because the car only clips them.
    """
    is_sac = "actor.1.0.weight" in weights
    graph = _Writer(weights, SAC_AGENT if is_sac else PPO_AGENT)
    order = embedders(spec, sensors)
    features = _features(graph, order, spec)
    first, *others = middleware(spec)
    features = graph.dense(first, features, first_dense_kernel(weights, order))
    for layer in others:
        features = graph.dense(layer, features)
    if is_sac:
        mean = _actor_mean(graph, features, spec.num_actions)
        graph.add(POLICY, "Tanh", mean)
    else:
        logits = graph.dense(policy_head(continuous=spec.continuous), features)
        graph.add(POLICY, "Identity" if spec.continuous else "Softmax", logits)
    return graph.nodes


def first_dense_kernel(weights: Weights, order: Sequence[Embedder]) -> NDArray[np.float32]:
    """With rows in the reference's order of features. Shape (features, width)."""
    kernel = weights["body.dense.0.weight"].T
    if len(order) == 1 or not order[0].is_lidar:
        return kernel
    return np.concatenate([kernel[-LIDAR_FEATURES:], kernel[:-LIDAR_FEATURES]])


class _Writer:
    def __init__(self, weights: Weights, agent: str) -> None:
        self.weights = weights
        self.agent = agent
        self.nodes: list[Node] = []

    def add(self, name: str, op: str, *inputs: str, **attrs: Attr) -> str:
        full = f"{self.agent}/{name}"
        kinds: dict[str, Attr] = {"T": DataType.FLOAT, **attrs}
        self.nodes.append(Node(full, op, inputs, kinds))
        return full

    def constant(self, name: str, value: Array) -> str:
        full = f"{self.agent}/{name}"
        self.nodes.append(Node(full, "Const", value=np.asarray(value, order="C")))
        return full

    def placeholder(self, full: str, shape: Shape) -> None:
        attrs: dict[str, Attr] = {"dtype": DataType.FLOAT, "shape": shape}
        self.nodes.append(Node(full, "Placeholder", (), attrs))

    def variable(self, name: str, value: Array) -> str:
        """With a node that reads it, as in the reference's graphs."""
        return self.add(f"{name}/read", "Identity", self.constant(name, value))

    def bias_add(self, scope: str, values: str, bias: Array) -> str:
        read = self.variable(f"{scope}/bias", bias)
        return self.add(f"{scope}/BiasAdd", "BiasAdd", values, read, data_format="NHWC")

    def matmul(self, scope: str, values: str, kernel: Array) -> str:
        read = self.variable(f"{scope}/kernel", kernel)
        return self.add(
            f"{scope}/MatMul", "MatMul", values, read, transpose_a=False, transpose_b=False
        )

    def convolve(self, scope: str, values: str, kernel: Array, stride: tuple[int, int]) -> str:
        """Kernel: (rows, columns, channels, filters)."""
        read = self.variable(f"{scope}/kernel", kernel)
        return self.add(
            f"{scope}/Conv2D",
            "Conv2D",
            values,
            read,
            strides=(1, *stride, 1),
            padding="VALID",
            data_format="NHWC",
            dilations=(1, 1, 1, 1),
            use_cudnn_on_gpu=True,
        )

    def reshape(self, name: str, values: str, width: int) -> str:
        shape = self.constant(f"{name}/shape", np.array([-1, width], np.int32))
        return self.add(name, "Reshape", values, shape, Tshape=DataType.INT32)

    def dense(self, layer: Layer, values: str, kernel: Array | None = None) -> str:
        if kernel is None:
            kernel = self.weights[f"{layer.ours}.weight"].T
        scope = f"{POLICY_BODY}/{layer.scope}"
        product = self.matmul(scope, values, kernel)
        return self._activated(layer, product)

    def convolution(self, layer: Layer, values: str) -> str:
        weight = self.weights[f"{layer.ours}.weight"]
        scope = f"{POLICY_BODY}/{layer.scope}"
        if layer.stride is None:
            kernel = weight.T.reshape(1, 1, *weight.T.shape)
        else:
            kernel = weight.transpose(2, 3, 1, 0)
        return self._activated(layer, self.convolve(scope, values, kernel, layer.stride or (1, 1)))

    def _activated(self, layer: Layer, values: str) -> str:
        bias = self.weights[f"{layer.ours}.bias"]
        values = self.bias_add(f"{POLICY_BODY}/{layer.scope}", values, bias)
        if not layer.activation:
            return values
        return self.add(f"{POLICY_BODY}/{layer.activation}", "Relu", values)


def _features(graph: _Writer, order: Sequence[Embedder], spec: PolicySpec) -> str:
    parts = []
    for embedder in order:
        shape: tuple[int, ...] = (spec.scan_dims,)
        if not embedder.is_lidar:
            shape = (FRAME_HEIGHT, FRAME_WIDTH, spec.channels)
        name = input_name(graph.agent, embedder.sensor)
        graph.placeholder(name, Shape((-1, *shape)))
        parts.append(_embedded(graph, embedder, name))
    if len(parts) == 1:
        return parts[0]
    axis = graph.constant(f"{POLICY_BODY}/concat/axis", np.array(1, np.int32))
    name = f"{POLICY_BODY}/concat"
    return graph.add(name, "ConcatV2", *parts, axis, N=len(parts), Tidx=DataType.INT32)


def _embedded(graph: _Writer, embedder: Embedder, values: str) -> str:
    scope = f"{POLICY_BODY}/{embedder.sensor}"
    if embedder.is_lidar:
        for layer in embedder.layers:
            values = graph.dense(layer, values)
        return values
    scale = graph.constant(f"{scope}/truediv/y", np.array(255.0, np.float32))
    values = graph.add(f"{scope}/truediv", "RealDiv", values, scale)
    for layer in embedder.layers:
        values = graph.convolution(layer, values)
    flat = graph.weights["body.dense.0.weight"].shape[1]
    if "body.lidar.0.weight" in graph.weights:
        flat -= LIDAR_FEATURES
    return graph.reshape(f"{scope}/Flatten/flatten/Reshape", values, flat)


def _actor_mean(graph: _Writer, features: str, num_actions: int) -> str:
    """SAC's actor up to the mean before tanh.

    Layer norm's mean is linear in the inputs, so it is subtracted from the kernel beforehand.
    """
    w, scope = graph.weights, f"{POLICY_BODY}/sac_head_0"
    weight, bias = w["actor.0.0.weight"].astype(np.float64), w["actor.0.0.bias"].astype(np.float64)
    kernel = (weight - weight.mean(axis=0)).T.astype(np.float32)
    values = graph.matmul(f"{scope}/Dense_0", features, kernel)
    centred = (bias - bias.mean()).astype(np.float32)
    values = graph.bias_add(f"{scope}/Dense_0", values, centred)
    squares = graph.add(f"{scope}/norm/Square", "Mul", values, values)
    mean = np.full((len(bias), 1), 1.0 / len(bias), np.float32)
    variance = graph.matmul(f"{scope}/norm/variance", squares, mean)
    epsilon = np.array([_NORM_EPSILON], np.float32)
    variance = graph.bias_add(f"{scope}/norm/variance", variance, epsilon)
    scale = graph.add(f"{scope}/norm/Rsqrt", "Rsqrt", variance)
    values = graph.add(f"{scope}/norm/mul", "Mul", values, scale)
    gamma = graph.variable(f"{scope}/norm/gamma", w["actor.0.1.weight"])
    values = graph.add(f"{scope}/norm/mul_1", "Mul", values, gamma)
    values = graph.bias_add(f"{scope}/norm/beta", values, w["actor.0.1.bias"])
    values = graph.add(f"{scope}/norm/Tanh", "Tanh", values)
    for number, place in enumerate((0, 2)):
        layer = Layer(
            f"actor.1.{place}", f"sac_head_0/Dense_{number + 1}", f"sac_head_0/Relu_{number}"
        )
        values = graph.dense(layer, values)
    last = f"{scope}/policy_mean"  # without the rows of the standard deviation
    values = graph.matmul(last, values, w["actor.1.4.weight"][:num_actions].T)
    return graph.bias_add(last, values, w["actor.1.4.bias"][:num_actions])


# Compares a frozen graph with its network.


TOLERANCE = 1e-4
"""Rounding alone stays below 1e-5."""

LEAST_SAME_ACTIONS = 0.999
_BATCH = 32
"""Keeps the interpreter's memory small."""

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class GraphComparison:
    """How a graph and its network differ.

    Attributes:
        same_actions: Frames with the same likeliest action, or continuous actions within 1e-4.
        greatest_difference: Of a probability, or of an action from -1 to 1.
    """

    frames: int
    same_actions: int
    greatest_difference: float

    @property
    def is_equal(self) -> bool:
        same = self.same_actions >= LEAST_SAME_ACTIONS * self.frames
        return same and self.greatest_difference <= TOLERANCE


def compare_graph(data: bytes, model: Network, seen: Observation, origin: str) -> GraphComparison:
    """SettingsError if the graph cannot run."""
    graph = Graph(decode_graph(data, origin), origin)
    steps = len(seen.frames)
    wanted, got = [], []
    for first in range(0, steps, _BATCH):
        part = seen.part(slice(first, first + _BATCH))
        wanted.append(policy_output(model, part))
        got.append(graph.run(graph_inputs(graph, part)))
    expected, found = np.concatenate(wanted), np.concatenate(got)
    if found.shape != expected.shape:
        raise SettingsError(
            f"{origin} has {found.shape[-1]} outputs, but its network has {expected.shape[-1]}.",
            remedy="Export the model again.",
        )
    return compare_outputs(expected, found, continuous=model.spec.continuous)


def compare_outputs(expected: Floats, found: Floats, *, continuous: bool) -> GraphComparison:
    if not np.isfinite(found).all():
        return GraphComparison(len(found), 0, float("inf"))
    differences = np.abs(expected.astype(np.float64) - found)
    if continuous:
        same = (np.abs(expected.clip(-1, 1) - found.clip(-1, 1)) <= TOLERANCE).all(axis=1)
    else:
        # Two actions that are equally likely may change places when they are rounded.
        chosen = np.take_along_axis(expected, found.argmax(axis=1)[:, None], axis=1)[:, 0]
        same = chosen >= expected.max(axis=1) - TOLERANCE / 10
    return GraphComparison(len(found), int(same.sum()), float(differences.max(initial=0.0)))


def policy_output(model: Network, seen: Observation) -> Floats:
    """Shape (n, num_actions)."""
    with torch.inference_mode():
        array: Floats = model.outputs(seen).float().numpy()
    return array


def graph_inputs(graph: Graph, seen: Observation) -> dict[str, Floats]:
    """Pictures with channels last, lidar values."""
    frames = seen.frames.permute(0, 2, 3, 1).float().numpy()
    scan = seen.scan.float().numpy()
    return {name: scan if name.rpartition("/")[2] in LIDARS else frames for name in graph.inputs}
