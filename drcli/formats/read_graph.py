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

from drcli.base.errors import SettingsError
from drcli.base.problems import shown
from drcli.formats.build_network import load_arrays
from drcli.formats.frozen_graph import LIDAR_FEATURES
from drcli.formats.policy_layers import Linear, Trunk, find_layers
from drcli.formats.tensorflow.graph import Node, Shape, decode_graph
from drcli.formats.tensorflow.interpreter import Graph
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.encoders import MONO
from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation, PolicySpec
from drcli.modelfiles.model_metadata import CAMERAS, LIDARS

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
        if sensor not in CAMERAS + LIDARS:
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
    eyes = 2 if camera == "STEREO_CAMERAS" else 1
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
