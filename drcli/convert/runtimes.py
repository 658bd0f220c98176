"""Policies in PyTorch, our interpreter, onnxruntime, OpenVINO or LiteRT."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NoReturn

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from drcli.base.errors import DrError, NotAvailable, SettingsError, few, shown
from drcli.convert.build_network import weights_of
from drcli.convert.engines import RUNS, Array, Engine, Port, check_runtime, open_engine, reason_of
from drcli.convert.frozen_graph import encode_policy
from drcli.convert.policy_file import PolicyFile
from drcli.learn import distributions
from drcli.learn.encoders import Network
from drcli.learn.policy import Observation, Policy, PolicySpec
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.sensors import CAMERAS, LIDARS, SENSORS, usual_names
from drcli.records.evaluation_task import Runtime

# Fits inputs, layouts and output of any graph to its metadata.


Floats = NDArray[np.float32]
Layout = Literal["NHWC", "NCHW", "NHW"]
Meaning = Literal["probabilities", "logits", "index", "continuous"]

HEIGHT, WIDTH = 120, 160
"""Not from `drcli.learn.policy`, which loads torch: a second."""

MOST_FRAMES = 16
_PROBED = 3
_SAMPLES = 4
"""Of a run; more take hardly less time each."""

_SUM_TOLERANCE = 0.02
"""Half precision makes errors of 0.001."""

_SENSORS = sorted(SENSORS, key=len, reverse=True)
"""LIDAR is a part of other names."""


@dataclass(frozen=True)
class Fit:
    """The inputs and the output of a graph.

    Attributes:
        layout: NHW has no channels.
        stack: Frames that it sees together.
        meaning: The share of each action, any other number for each, the index of the likeliest
            one, or continuous actions.
        batch: Samples at a time; None for any number.
    """

    camera: Port
    layout: Layout
    stack: int
    lidar: Port | None
    output: str
    meaning: Meaning
    batch: int | None

    def feeds(self, engine: Engine, frames: NDArray[np.uint8], scans: Floats) -> dict[str, Array]:
        """Inputs from frames (n, stack * eyes, 120, 160) and scans (n, d)."""
        pictures: Array = frames
        if self.layout == "NHWC":
            pictures = frames.transpose(0, 2, 3, 1)
        elif self.layout == "NHW":
            pictures = frames[:, 0]
        if engine.pixel_scale != 1.0:
            pictures = pictures * np.float32(engine.pixel_scale)
        fed = {self.camera.name: np.ascontiguousarray(pictures, self.camera.dtype)}
        if self.lidar is not None:
            fed[self.lidar.name] = np.ascontiguousarray(scans, self.lidar.dtype)
        return fed

    def run(self, engine: Engine, frames: NDArray[np.uint8], scans: Floats) -> Floats:
        """The output, shape (n, actions), or (n, 1) for an index, in runs of one size.

        So a car depends on no other car: most engines round samples of larger runs differently.
        """
        size = self.batch or _SAMPLES
        parts = []
        for begin in range(0, len(frames), size):
            rows = np.arange(begin, begin + size).clip(max=len(frames) - 1)
            results = engine.run(self.feeds(engine, frames[rows], scans[rows]))
            parts.append(results[self.output].reshape(size, -1))
        return np.concatenate(parts)[: len(frames)].astype(np.float32)


def fit(
    engine: Engine,
    metadata: ModelMetadata,
    origin: str,
    metadata_origin: str,
    stack: int | None = None,
) -> Fit:
    """Find out how a graph is used, and try it.

    Raises:
        SettingsError: It does not fit the metadata or `stack`, or cannot be computed.
    """
    return _Fitting(engine, metadata, origin, metadata_origin).fit(stack)


def open_file(file: PolicyFile, runtime: Runtime, threads: int = 1) -> tuple[Engine, Fit]:
    """Load a policy's file into an engine, and fit it.

    Raises:
        SettingsError: It is damaged, does not fit, or the engine does not run it.
        NotAvailable: The engine is not installed.
    """
    engine = open_engine(file.form, file.data, file.weights, runtime, file.origin, threads)
    return engine, fit(engine, file.metadata, file.origin, file.metadata_origin)


def check_file(file: PolicyFile, runtime: Runtime) -> None:
    """Check a file before it drives; see `open_file`.

    Our interpreter tries graphs that must be converted, which takes less time.
    """
    check_runtime(file.form, runtime, file.origin)
    open_file(file, "pb" if file.form == "pb" else runtime)


class _Fitting:
    def __init__(
        self, engine: Engine, metadata: ModelMetadata, origin: str, metadata_origin: str
    ) -> None:
        self._engine = engine
        self._metadata = metadata
        self._origin = origin
        self._metadata_origin = metadata_origin

    def fit(self, stack: int | None) -> Fit:
        camera, lidar = self._ports()
        layout, frames = self._camera_layout(camera, stack)
        batches = {port.shape[0] for port in (camera, lidar) if port and port.shape}
        fixed = {size for size in batches if size > 0}
        if len(fixed) > 1:
            self._refuse(f"takes {sorted(fixed)} samples at different inputs", "one batch for all")
        batch = fixed.pop() if fixed else None
        found = Fit(camera, layout, frames, lidar, "", "logits", batch)
        output, meaning = self._output(found)
        return Fit(camera, layout, frames, lidar, output, meaning, batch)

    def _ports(self) -> tuple[Port, Port | None]:
        """By names, or else by shapes."""
        sensors = self._metadata.sensor
        wanted_lidar = next((name for name in sensors if name in LIDARS), None)
        wanted_camera = next(name for name in sensors if name in CAMERAS)
        ports = list(self._engine.inputs)
        named = {port.name: sensor_of(port.name) for port in ports}
        cameras = [p for p in ports if self._is_camera(p, named[p.name])]
        lidars = [p for p in ports if p not in cameras and self._is_lidar(p, named[p.name])]
        needs = " and ".join(sensors)
        if len(cameras) != 1 or len(lidars) != (wanted_lidar is not None):
            listed = ", ".join(few([f"{shown(p.name)} {_sizes(p.shape)}" for p in ports])) or "none"
            self._refuse(f"has the inputs {listed}", f"the sensors {needs}")
        others = [p for p in ports if p not in (*cameras, *lidars)]
        if others:
            self._refuse(f"has an input {shown(others[0].name)}", f"only the sensors {needs}")
        camera, lidar = cameras[0], lidars[0] if lidars else None
        for port, wanted in ((camera, wanted_camera), (lidar, wanted_lidar)):
            if port is None or wanted is None:
                continue
            sensor = named[port.name]
            same = sensor is None or usual_names([sensor]) == usual_names([wanted])
            if not same:
                self._refuse(f"has the input {sensor}", f"the sensor {wanted}")
            if port.dtype.kind not in "fui":
                self._refuse(f"takes values that are no numbers as {wanted}", "numbers there")
        width = self._metadata.scan_dims
        shape = None if lidar is None else lidar.shape
        if shape is not None and (len(shape) != 2 or shape[1] not in (-1, width)):
            self._refuse(f"takes {_sizes(shape)} values as {wanted_lidar}", f"{width} of them")
        return camera, lidar

    @staticmethod
    def _is_camera(port: Port, sensor: str | None) -> bool:
        return sensor in CAMERAS or (
            sensor is None and port.shape is not None and len(port.shape) > 2
        )

    @staticmethod
    def _is_lidar(port: Port, sensor: str | None) -> bool:
        return sensor in LIDARS or (
            sensor is None and port.shape is not None and len(port.shape) == 2
        )

    def _camera_layout(self, port: Port, stack: int | None) -> tuple[Layout, int]:
        eyes = self._metadata.eyes
        expected = eyes * (stack or 1)
        pictures = f"pictures of {HEIGHT} x {WIDTH} pixels and {_channels(expected)}"
        shape = port.shape
        if shape is None:
            self._refuse("has an input without a shape", pictures)
        choices: list[tuple[Layout, int]] = []
        if len(shape) == 4:
            if shape[1:3] == (HEIGHT, WIDTH):
                choices.append(("NHWC", shape[3]))
            if shape[2:] == (HEIGHT, WIDTH):
                choices.append(("NCHW", shape[1]))
        elif len(shape) == 3 and shape[1:] == (HEIGHT, WIDTH):
            choices.append(("NHW", 1))
        if len(choices) != 1:
            self._refuse(f"takes pictures of the shape {_sizes(shape)}", pictures)
        layout, channels = choices[0]
        channels = expected if channels == -1 else channels
        frames, odd = divmod(channels, eyes)
        if odd or not 1 <= frames <= MOST_FRAMES or (stack is not None and frames != stack):
            self._refuse(f"takes pictures of {_channels(channels)}", pictures)
        return layout, frames

    def _output(self, found: Fit) -> tuple[str, Meaning]:
        rows = found.batch or _PROBED
        results = self._tried(found, rows)
        space = self._metadata.action_space
        count = space.num_actions
        wide = [name for name, values in results.items() if _is_row_of(values, rows, count)]
        if len(wide) > 1:
            wide = [name for name in wide if re.search(_POLICY, name)] or wide
        if wide:
            values = results[wide[0]].reshape(rows, count)
            if not np.isfinite(values).all():
                self._refuse("gives values that are not numbers", f"{count} actions")
            if space.continuous:
                return wide[0], "continuous"
            return wide[0], "probabilities" if are_probabilities(values) else "logits"
        whole = [n for n, v in results.items() if v.size == rows and v.dtype.kind in "iu"]
        if not whole or space.continuous:
            given = ", ".join(few([f"{shown(n)} {_sizes(v.shape)}" for n, v in results.items()]))
            actions = f"{count} {self._metadata.action_space_type} action{'s' * (count > 1)}"
            self._refuse(f"gives {given} for {rows} picture{'s' * (rows > 1)}", actions)
        chosen = results[whole[0]]
        if chosen.min() < 0 or chosen.max() >= count:
            self._refuse(f"chooses action {int(chosen.max())}", f"only {count} actions from 0 on")
        return whole[0], "index"

    def _tried(self, found: Fit, rows: int) -> dict[str, Array]:
        random = np.random.default_rng(0)
        channels = found.stack * self._metadata.eyes
        frames = random.integers(0, 256, (rows, channels, HEIGHT, WIDTH), np.uint8)
        scans = random.random((rows, self._metadata.scan_dims), np.float32)
        try:
            return self._engine.run(found.feeds(self._engine, frames, scans))
        except (DrError, MemoryError):
            raise
        except Exception as error:  # engines raise whatever their C++ code does
            raise SettingsError(
                f"{self._origin} cannot be computed by {self._engine.name}: {reason_of(error)}",
                remedy="Write the file again, or name another one.",
            ) from None

    def _refuse(self, has: str, wanted: str) -> NoReturn:
        raise SettingsError(
            f"{self._origin} {has}, but {self._metadata_origin} has {wanted}.",
            remedy="Name the model_metadata.json that the policy was trained with, with "
            "--metadata FILE.",
        )


_POLICY = r"(?i)policy|prob|logit|action"


def sensor_of(name: str) -> str | None:
    return next((sensor for sensor in _SENSORS if sensor in name), None)


def are_probabilities(values: Floats) -> bool:
    sums = values.sum(axis=1)
    return bool(values.min() >= 0.0 and np.abs(sums - 1.0).max() < _SUM_TOLERANCE)


def _is_row_of(values: Array, rows: int, count: int) -> bool:
    fits = values.ndim and values.size == rows * count and values.shape[-1] == count
    return bool(fits) and values.dtype.kind == "f"


def _channels(count: int) -> str:
    return f"{count} channel{'s' * (count != 1)}"


def _sizes(shape: Sequence[int] | None) -> str:
    if shape is None:
        return "(of any shape)"
    return "(" + " x ".join("any" if size < 0 else str(size) for size in shape) + ")"


_LEAST_PROBABILITY = 1e-30


class EnginePolicy:
    """A graph in an engine as a `Policy`.

    Discrete actions are drawn unless it only says the likeliest; of continuous ones it has the mean
    alone.
    """

    def __init__(self, engine: Engine, found: Fit, spec: PolicySpec, origin: str) -> None:
        self.spec = spec
        self._engine = engine
        self._fit = found
        self._origin = origin

    def outputs(self, frames: NDArray[np.uint8], scans: NDArray[np.float32]) -> NDArray[np.float32]:
        """Probabilities (1 for an index) or continuous actions, shape (n, num_actions).

        Args:
            frames: Shape (n, stack * eyes, 120, 160).
            scans: Shape (n, d).

        Raises:
            SettingsError: Outputs are not numbers.
        """
        values = self._fit.run(self._engine, frames, scans)
        if not np.isfinite(values).all():
            raise SettingsError(
                f"{self._origin} gives values that are not numbers.",
                remedy="Export it again from another checkpoint.",
            )
        if self._fit.meaning == "index":
            return self._certain(values[:, 0].astype(np.int64))
        if self._fit.meaning == "logits":
            powers = np.exp(values - values.max(axis=1, keepdims=True))
            values = powers / powers.sum(axis=1, keepdims=True)
        return values

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `Policy.act`; estimates and log-probabilities of continuous actions are 0.

        Raises:
            NotAvailable: Only the mean is known, so nothing can be drawn.
            SettingsError: Outputs are not numbers.
        """
        values = torch.from_numpy(self.outputs(seen.frames.numpy(), seen.scan.numpy()))
        nothing = torch.zeros(len(values), dtype=torch.float64)
        if self.spec.continuous:
            if not bool(deterministic.all()):
                raise self._only_the_best("mean of the actions")
            return values, nothing.float(), nothing
        best = values.argmax(-1)
        logits = values.clamp(min=_LEAST_PROBABILITY).log()
        if bool(deterministic.all()):
            drawn = best
        elif self._fit.meaning == "index":
            raise self._only_the_best("likeliest action")
        elif epsilon is None:
            drawn = distributions.sample_categorical(logits, noise[:, 0].contiguous())
        else:
            drawn = distributions.sample_e_greedy(logits, noise, epsilon)
        actions = torch.where(deterministic, best, drawn)
        return actions, distributions.log_prob_categorical(logits, actions), nothing

    def _certain(self, indices: NDArray[np.int64]) -> NDArray[np.float32]:
        count = self.spec.num_actions
        if indices.min() < 0 or indices.max() >= count:
            raise SettingsError(
                f"{self._origin} chooses action {indices.max()}, but its model_metadata.json has "
                f"only {count} actions from 0 on.",
                remedy="Name the model_metadata.json that the policy was trained with, with "
                "--metadata FILE.",
            )
        return np.eye(count, dtype=np.float32)[indices]

    def _only_the_best(self, what: str) -> NotAvailable:
        return NotAvailable(
            f"No actions can be drawn from {self._origin}: it only has the {what}.",
            remedy="Drive it in an evaluation, which takes those.",
        )


def policy_of_file(
    file: PolicyFile, runtime: Runtime | None = None, threads: int = 1
) -> EnginePolicy:
    """The policy in a file, by default in the engine of its form.

    Raises:
        SettingsError: It is damaged, does not fit, or that engine does not run it.
        NotAvailable: The engine is not installed.
    """
    runtime = runtime or RUNS[file.form][0]
    engine, found = open_file(file, runtime, threads)
    spec = _spec(file.metadata, found.stack)
    return EnginePolicy(engine, found, spec, file.origin)


def policy_of_model(
    model: Network,
    metadata: ModelMetadata,
    runtime: Runtime,
    origin: str,
    threads: int = 1,
) -> Policy:
    """The network itself, or its graph in an engine.

    Raises:
        NotAvailable: The engine or its converter is not installed.
    """
    if runtime == "torch":
        return model
    spec = model.spec
    graph = encode_policy(weights_of(model), spec, metadata.sensor)
    engine = open_engine("pb", graph, b"", runtime, origin, threads)
    found = fit(engine, metadata, origin, "model_metadata.json", spec.stack)
    return EnginePolicy(engine, found, _spec(metadata, spec.stack), origin)


def _spec(metadata: ModelMetadata, stack: int) -> PolicySpec:
    space = metadata.action_space
    return PolicySpec(
        num_actions=space.num_actions,
        continuous=space.continuous,
        network=metadata.neural_network,
        eyes=metadata.eyes,
        stack=stack,
        scan_dims=metadata.scan_dims,
    )
