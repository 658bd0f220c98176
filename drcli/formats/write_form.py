"""Writes a network in another form, and compares it with PyTorch."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.exchange.policy_source import Runtime
from drcli.formats.build_network import build_policy, load_weights, weights_of
from drcli.formats.convert_graph import openvino_of, tflite_of
from drcli.formats.engine_fit import fit
from drcli.formats.frozen_graph import encode_policy
from drcli.formats.onnx_graph import encode_onnx
from drcli.formats.policy_engines import RUNS, open_engine
from drcli.formats.policy_file import Form
from drcli.formats.runtimes import EnginePolicy
from drcli.formats.tensorflow.graph import decode_graph
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation, PolicySpec
from drcli.learn.sac_networks import SACAgent
from drcli.modelfiles.network_shape import Design

Network = ActorCritic | SACAgent

FRAMES = 32
_AT_A_TIME = 8

_ALLOWED = 1e-4
_ALLOWED_HALF = 1e-2
"""Of a probability or action (in proportion above 1), in half precision."""


@dataclass(frozen=True)
class Comparison:
    """With PyTorch."""

    frames: int
    same_actions: float
    greatest_difference: float


@dataclass(frozen=True)
class WrittenForm:
    """Files by their ends, the one that is named last."""

    files: Mapping[str, bytes]
    engine: Runtime
    compared: Comparison


def write_form(
    form: Form, design: Design, weights: bytes, origin: str, *, fp16: bool = False
) -> WrittenForm:
    """Write a checkpoint in another form, run it, and compare it with PyTorch.

    `fp16` is for OpenVINO; TensorFlow Lite always has half precision.

    Raises:
        NotAvailable: Converter or engine is not installed.
        SettingsError: The checkpoint does not fit, or the file gives other actions.
    """
    model = build_policy(design.metadata, design.parameters)
    load_weights(model, weights, origin)
    graph = encode_policy(weights_of(model), model.spec, design.metadata.sensor)
    files: dict[str, bytes]
    match form:
        case "pb":
            files = {".pb": graph}
        case "onnx":
            files = {".onnx": encode_onnx(decode_graph(graph, origin), origin)}
        case "openvino":
            xml, weights_file = openvino_of(graph, origin, fp16=fp16)
            files = {".bin": weights_file, ".xml": xml}
        case "tflite":
            files = {".tflite": tflite_of(graph, origin)}
    engine = RUNS[form][0]
    policy = _opened(form, files, engine, model.spec, design, origin)
    half = fp16 or form == "tflite"
    frames, scans = sample_inputs(model.spec, FRAMES)
    compared = compare(model, policy, frames, scans)
    most = _ALLOWED_HALF if half else _ALLOWED
    if not compared.greatest_difference <= most:
        raise SettingsError(
            f"{origin} as {form} gives other actions than PyTorch: they differ by "
            f"{compared.greatest_difference:.2g}, and {most:g} is allowed.",
            remedy="Nothing was written. Export another checkpoint or another form.",
        )
    return WrittenForm(files, engine, compared)


def _opened(
    form: Form,
    files: Mapping[str, bytes],
    engine_name: Runtime,
    spec: PolicySpec,
    design: Design,
    origin: str,
) -> EnginePolicy:
    data = [files[end] for end in sorted(files, key=lambda end: end == ".bin")]
    weights = data[1] if len(data) > 1 else b""
    engine = open_engine(form, data[0], weights, engine_name, origin)
    found = fit(engine, design.metadata, origin, design.metadata_origin, spec.stack)
    return EnginePolicy(engine, found, spec, origin)


def compare(
    model: Network,
    policy: EnginePolicy,
    frames: NDArray[np.uint8],
    scans: NDArray[np.float32],
) -> Comparison:
    """Frames have shape (n, stack * eyes, 120, 160), scans (n, d)."""
    return compare_outputs(
        torch_outputs(model, frames, scans), policy, frames, scans, continuous=model.spec.continuous
    )


def compare_outputs(
    ours: NDArray[np.float32],
    policy: EnginePolicy,
    frames: NDArray[np.uint8],
    scans: NDArray[np.float32],
    *,
    continuous: bool,
) -> Comparison:
    """With what `torch_outputs` gave."""
    parts = [slice(begin, begin + _AT_A_TIME) for begin in range(0, len(frames), _AT_A_TIME)]
    theirs = np.concatenate([policy.outputs(frames[part], scans[part]) for part in parts])
    same = 1.0
    if not continuous:
        same = float((ours.argmax(axis=1) == theirs.argmax(axis=1)).mean())
    scale = max(1.0, float(np.abs(ours).max()))
    return Comparison(len(frames), same, float(np.abs(ours - theirs).max()) / scale)


def torch_outputs(
    model: Network, frames: NDArray[np.uint8], scans: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Shape (n, num_actions)."""
    if len(frames) > _AT_A_TIME:
        parts = [slice(begin, begin + _AT_A_TIME) for begin in range(0, len(frames), _AT_A_TIME)]
        return np.concatenate([torch_outputs(model, frames[part], scans[part]) for part in parts])
    states = np.zeros((len(frames), model.spec.state_dims), np.float32)
    seen = Observation.of_arrays(frames, scans, states)
    with torch.inference_mode():
        if isinstance(model, SACAgent):
            outputs: torch.Tensor = torch.tanh(model(model.features(seen))[0])
        else:
            outputs = model(seen).policy
            if not model.spec.continuous:
                outputs = outputs.softmax(-1)
    array: NDArray[np.float32] = outputs.numpy()
    return array


def sample_inputs(
    spec: PolicySpec, count: int, seed: int = 0
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Patches of grey with noise: shapes (count, stack * eyes, 120, 160) and (count, scan_dims)."""
    random = np.random.default_rng(seed)
    frames = np.empty((count, spec.channels, FRAME_HEIGHT, FRAME_WIDTH), np.uint8)
    for number, picture in enumerate(frames):
        size = (1, 2, 4, 8, 20, 40)[number % 6]
        rows, columns = FRAME_HEIGHT // size, FRAME_WIDTH // size
        patches = random.integers(0, 256, (spec.channels, rows, columns))
        large = patches.repeat(size, axis=1).repeat(size, axis=2)
        noise = random.normal(0.0, 8.0, picture.shape)
        picture[:] = np.clip(large + noise, 0, 255)
    return frames, random.random((count, spec.scan_dims), np.float32)
