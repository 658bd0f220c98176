"""The archive that the physical car loads, written and checked."""

import gzip
import io
import json
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from drcli.base import errors
from drcli.base.archive import unpack_archive
from drcli.base.errors import Problem, SettingsError, few, shown
from drcli.base.files import is_left_behind
from drcli.convert.car_rules import (
    GRAPH,
    CarAction,
    action_problems,
    car_actions,
    file_name_problems,
    member_problems,
    read_car_metadata,
    sensor_problems,
)
from drcli.convert.policy_file import METADATA
from drcli.convert.reference_names import POLICY, PPO_AGENT, SAC_AGENT, input_name
from drcli.convert.tensorflow.graph import Node, decode_graph
from drcli.convert.tensorflow.interpreter import Graph
from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.sensors import SENSORS

# Checks whether the physical car can run a frozen graph.


_CONVERTED = frozenset(
    (
        *("Placeholder", "Const", "Identity", "StopGradient"),
        *("Conv2D", "BiasAdd", "MatMul", "Relu", "Tanh", "Softmax"),
        *("RealDiv", "Sub", "Mul", "Add", "AddV2", "Rsqrt"),
        *("Reshape", "ConcatV2", "Shape", "StridedSlice", "Pack"),
    )
)
"""By all engines of the car. Source: graphs that went through them."""

_SAC_OUTPUT = "network_0/sac_policy_head_0/policy"
"""The reference's; the car does not look there."""

_SMALL = 1024
_REMEDY = "Export the model again, with `dr-export car`."


def graph_problems(
    data: bytes, sensors: Sequence[str], algorithm: str, num_actions: int | None, file: str
) -> list[Problem]:
    """What the car refuses in a graph; `algorithm` decides where it looks for inputs."""
    try:
        nodes = decode_graph(data, file)
    except SettingsError as error:
        return [Problem("C-09", "error", file, None, str(error), error.remedy)]
    agent = SAC_AGENT if algorithm == "sac" else PPO_AGENT
    problems = [
        *_value_problems(nodes, file),
        *_input_problems(nodes, agent, sensors, file),
        *_output_problems(nodes, agent, num_actions, file),
        *_operation_problems(nodes, file),
    ]
    if not problems:
        problems += _shape_problems(nodes, agent, sensors, num_actions, file)
    return problems


def _value_problems(nodes: Sequence[Node], file: str) -> Iterator[Problem]:
    for node in nodes:
        if node.value is not None and not np.isfinite(node.value).all():
            what = f"the values of {shown(node.name)} are not all finite numbers."
            yield _problem(
                "C-09", file, what, "Export a checkpoint from before the training failed."
            )


def _input_problems(
    nodes: Sequence[Node], agent: str, sensors: Sequence[str], file: str
) -> Iterator[Problem]:
    found = {node.name: node for node in nodes if node.op == "Placeholder"}
    wanted = {input_name(agent, sensor): sensor for sensor in sensors}
    for name, sensor in wanted.items():
        if name not in found:
            listed = ", ".join(few(map(shown, found))) or "none"
            what = f"it has no input {name}, where the car puts {sensor}; its inputs: {listed}."
            yield _problem("C-10", file, what, _REMEDY)
            continue
        shape = found[name].attrs.get("shape")
        given = _shape_of(sensor)
        if not isinstance(shape, tuple) or len(shape) < 2:
            continue
        fits = len(shape) == len(given) + 1 and shape[0] in (-1, 1)
        if not fits or any(
            size not in (-1, known) for size, known in zip(shape[1:], given, strict=True)
        ):
            what = (
                f"its input {sensor} has the shape {_sizes(shape)}, but the car gives it "
                f"{_sizes((1, *given))}."
            )
            yield _problem("C-10", file, what, "Train with the sensors that the car has.")
    for name in sorted(found.keys() - wanted.keys()):
        what = f"the car gives nothing to its input {shown(name)}, which no sensor belongs to."
        yield _problem(
            "C-10", file, what, "Take the metadata file that the model was trained with."
        )


def _output_problems(
    nodes: Sequence[Node], agent: str, num_actions: int | None, file: str
) -> Iterator[Problem]:
    by_name = {node.name: node for node in nodes}
    output = f"{agent}/{POLICY}"
    if output not in by_name:
        raw = f"{agent}/{_SAC_OUTPUT}"
        if raw not in by_name:
            what = f"it has no node {output}, which the car takes the actions from."
            yield _problem("C-11", file, what, _REMEDY)
            return
        what = (
            f"its output is {raw}: cars with TensorFlow Lite do not find it, and all cars clip its "
            "values, which the simulator squashes with tanh, so they steer and drive harder."
        )
        yield Problem("C-11", "warning", file, None, what, _REMEDY)
        output = raw
    taken = {name for node in nodes for name in node.inputs}
    others = [node.name for node in nodes if node.name not in taken and node.name != output]
    if others:
        what = (
            f"it has more outputs than {output}, and some engines of the car take another: "
            f"{', '.join(few(map(shown, others)))}."
        )
        yield Problem("C-11", "warning", file, None, what, _REMEDY)
    width = _width(by_name, output)
    if num_actions is not None and width is not None and width != num_actions:
        what = f"its output has {width} values, but the metadata file needs {num_actions}."
        yield _problem(
            "C-11", file, what, "Take the metadata file that the model was trained with."
        )


def _shape_problems(
    nodes: Sequence[Node],
    agent: str,
    sensors: Sequence[str],
    num_actions: int | None,
    file: str,
) -> Iterator[Problem]:
    """Whether shapes fit, found by running the graph on no picture at all.

    That takes no time, whatever a stranger's graph would compute.
    """
    try:
        graph = Graph(nodes, file)
        if any(not shape or shape[0] != -1 for shape in graph.inputs.values()):
            return
        if constant := _computed_constant(graph):
            what = f"it computes {shown(constant)} from constants alone, so it cannot be checked."
            yield Problem("C-12", "warning", file, None, what, _REMEDY)
            return
        given = {input_name(agent, sensor): (0, *_shape_of(sensor)) for sensor in sensors}
        with np.errstate(all="ignore"):
            output = graph.run({name: np.zeros(shape, np.float32) for name, shape in given.items()})
    except SettingsError as error:
        yield Problem("C-09", "error", file, None, str(error), error.remedy)
        return
    width = output.shape[-1] if output.ndim == 2 else 0
    if num_actions is not None and width != num_actions:
        yield _wrong_width(width, num_actions, file)


def _computed_constant(graph: Graph) -> str | None:
    """A large node that depends on no input."""
    depends: set[str] = set()
    large = {n.name for n in graph.nodes if n.value is not None and n.value.size > _SMALL}
    for node in graph.nodes:
        if node.op == "Placeholder" or depends.intersection(node.inputs):
            depends.add(node.name)
        elif large.intersection(node.inputs):
            if node.op != "Identity":
                return node.name
            large.add(node.name)
        elif node.op not in ("Const", "Identity"):
            large.add(node.name)  # it was computed, so nothing else may be computed from it
    return None


def _operation_problems(nodes: Sequence[Node], file: str) -> Iterator[Problem]:
    unknown = sorted({node.op for node in nodes} - _CONVERTED)
    if unknown:
        what = (
            f"it has operations that the engines of the car may not convert: "
            f"{', '.join(few(map(shown, unknown)))}."
        )
        yield Problem("C-12", "warning", file, None, what, "Try it on the car before a race.")


def _wrong_width(width: int, num_actions: int, file: str) -> Problem:
    what = f"its output has {width} values, but the metadata file needs {num_actions}."
    return _problem("C-11", file, what, "Take the metadata file that the model was trained with.")


def _width(by_name: Mapping[str, Node], output: str) -> int | None:
    name = output
    for _ in range(len(by_name)):
        node = by_name.get(name)
        if node is None or not node.inputs:
            return None
        if node.op in ("MatMul", "BiasAdd") and len(node.inputs) == 2:
            value = _constant(by_name, node.inputs[1])
            if value is not None:
                return value
        name = node.inputs[0]
    return None


def _constant(by_name: Mapping[str, Node], name: str) -> int | None:
    for _ in range(len(by_name)):
        node = by_name.get(name)
        if node is None:
            return None
        if node.value is not None:
            return int(node.value.shape[-1]) if node.value.ndim else None
        if node.op != "Identity" or not node.inputs:
            return None
        name = node.inputs[0]
    return None


def _shape_of(sensor: str) -> tuple[int, ...]:
    known = SENSORS.get(sensor)
    if known is None or not known.on_car:
        return FRAME_HEIGHT, FRAME_WIDTH, 1
    return (FRAME_HEIGHT, FRAME_WIDTH, known.eyes) if known.eyes else (known.values,)


def _sizes(shape: Sequence[int]) -> str:
    return " x ".join("any" if size == -1 else str(size) for size in shape)


def _problem(rule: str, file: str, what: str, remedy: str) -> Problem:
    return Problem(rule, "error", file, None, what, remedy)


_LEVEL = 6
"""Weights hardly shrink, and higher levels take much longer."""


_GZIP = b"\x1f\x8b"


@dataclass(frozen=True)
class CarCheck:
    """What the car makes of an archive.

    Attributes:
        problems: What it refuses (error), does differently (warning), or a note.
        actions: Empty if it cannot read them.
        graph: Empty if it is unknown whether it runs.
    """

    problems: tuple[Problem, ...]
    actions: tuple[CarAction, ...] = ()
    sensors: tuple[str, ...] = ()
    graph: bytes = b""


def car_archive(graph: bytes, metadata: ModelMetadata) -> bytes:
    """The `.tar.gz` for a car; equal arguments give equal bytes.

    `graph` is frozen, with the reference's node names.
    """
    return _packed({METADATA: car_metadata(metadata), GRAPH: graph})


def without_leftovers(data: bytes, name: str) -> bytes:
    """An archive without what programs leave behind, which the car would take for a model.

    One that has nothing of this kind, or cannot be read, stays as it is.
    """
    try:
        files = unpack_archive(io.BytesIO(data), name, wanted=lambda _: True)
    except SettingsError:
        return data
    left = [member for member in files if is_left_behind(member)]
    if not left:
        return data
    errors.show(f"{name}: without {', '.join(few(map(shown, left)))}, which a program left there.")
    return _packed({member: files[member] for member in files if member not in left})


def _packed(files: Mapping[str, bytes]) -> bytes:
    packed = io.BytesIO()
    with (
        gzip.GzipFile("", "wb", _LEVEL, packed, mtime=0) as file,
        tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as archive,
    ):
        for name, data in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return packed.getvalue()


def car_metadata(metadata: ModelMetadata) -> bytes:
    """model_metadata.json as the car reads it.

    It compares words letter by letter, reads sensors whatever the version, and refuses a
    `lidar_config` with the simulator's keys.
    """
    values = {
        "action_space": json.loads(metadata.action_space_json),
        "sensor": list(metadata.sensor),
        "neural_network": metadata.neural_network,
        "training_algorithm": metadata.training_algorithm,
        "action_space_type": metadata.action_space_type,
        "version": metadata.version,
    }
    return json.dumps(values, indent=2).encode() + b"\n"


def lint_car_archive(data: bytes, name: str) -> list[Problem]:
    """See `check_car_archive`."""
    return list(check_car_archive(data, name).problems)


def check_car_archive(data: bytes, name: str) -> CarCheck:
    """Check an archive by the rules of the car."""
    try:
        # The car looks at all of them, also at those that macOS adds.
        files = unpack_archive(io.BytesIO(data), name, wanted=lambda _: True)
    except SettingsError as error:
        return CarCheck((Problem("C-01", "error", name, None, str(error), error.remedy),))
    problems = list(file_name_problems(PurePath(name).name))
    if not data.startswith(_GZIP):
        what = "it is not compressed, but the car's web page only takes a compressed .tar.gz."
        remedy = "Compress it with `gzip`."
        problems.append(Problem("C-01", "error", name, None, what, remedy))
    problems += member_problems(files.keys(), name)
    graphs = [member for member in files if member.endswith(".pb")]
    actions: list[CarAction] = []
    sensors: tuple[str, ...] = ()
    graph = b""
    if METADATA in files:
        place = f"{name}: {METADATA}"
        found = read_car_metadata(files[METADATA], place)
        sensors = found.sensors
        problems += [*found.problems, *sensor_problems(found.sensors, place)]
        num_actions = None
        if found.space is not None:
            num_actions = found.space.num_actions
            problems += action_problems(found.space, place)
            actions = car_actions(found.space)
        if len(graphs) == 1:
            place = f"{name}: {graphs[0]}"
            graph = files[graphs[0]]
            problems += graph_problems(graph, found.sensors, found.algorithm, num_actions, place)
    if any(problem.severity == "error" or problem.rule == "C-12" for problem in problems):
        graph = b""
    return CarCheck(tuple(problems), tuple(actions), sensors, graph)
