"""Exports a checkpoint as a policy for other engines: pb, onnx, tflite, openvino."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.base.files import refuse_existing, rewrite
from drcli.base.report import View, counted, size_text
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.settings import Settings
from drcli.convert.build_network import build_policy, load_weights, policy_spec, weights_of
from drcli.convert.engines import RUNS, check_converter, open_engine, openvino_of, tflite_of
from drcli.convert.frozen_graph import encode_policy, policy_nodes
from drcli.convert.onnx_graph import encode_onnx
from drcli.convert.policy_file import Form, metadata_path
from drcli.convert.reference_checkpoint import (
    encode_reference_checkpoint,
    export_notes,
    reference_variables,
    refuse_other_networks,
)
from drcli.convert.runtimes import EnginePolicy, fit
from drcli.convert.tensorflow.graph import decode_graph, encode_graph, encode_meta_graph
from drcli.learn.encoders import Network
from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation, PolicySpec
from drcli.model import keys
from drcli.model.checkpoint_list import HYPERPARAMETERS, METADATA, Item
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.records.evaluation_task import Runtime
from drcli.records.scores import Score
from drcli.transfer.export_model import (
    ExportSource,
    ExportTarget,
    Prepare,
    Selection,
    pointer_items,
    read_export_source,
    reference_score,
    unchanged,
    write_items,
)
from drcli.transfer.put_model import Progress

# Writes a network in another form, and compares it with PyTorch.


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
        array: NDArray[np.float32] = model.outputs(seen).numpy()
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


SUFFIXES: dict[Form, str] = {
    "pb": ".pb",
    "onnx": ".onnx",
    "openvino": ".xml",
    "tflite": ".tflite",
}


@dataclass(frozen=True)
class FormReport:
    """What was written, and how it was verified."""

    form: Annotated[Form, "pb, onnx, openvino or tflite."]
    prefix: Annotated[str, "The model."]
    checkpoint: Annotated[str, "Its checkpoint."]
    file: Annotated[str, "The file that `dr-evaluate --model` takes."]
    files: Annotated[list[str], "All files, with that one."]
    size_bytes: Annotated[int, "Of all of them."]
    engine: Annotated[Runtime, "What ran the file to compare it with PyTorch."]
    frames: Annotated[int, "Pictures that were compared."]
    same_actions: Annotated[
        float, "Share with the same likeliest action; 1 for continuous actions."
    ]
    greatest_difference: Annotated[float, "Of a probability, or of a continuous action."]

    def view(self) -> View:
        compared = f"Compared with PyTorch on {self.frames} pictures (--runtime {self.engine})"
        difference = f"greatest difference {self.greatest_difference:.1e}"
        size = size_text(self.size_bytes)
        return [
            f"Exported {self.checkpoint} of {self.prefix} as {self.file}, {size}.",
            f"{compared}: {self.same_actions:.1%} the same action, {difference}.",
            f"Beside it: {', '.join(file for file in self.files if file != self.file)}",
        ]


@dataclass(frozen=True)
class PlannedForm:
    form: Form
    source: ExportSource
    path: Path
    fp16: bool


def plan_form(
    settings: Settings,
    selection: Selection,
    form: Form,
    out: Path | None,
    *,
    fp16: bool = False,
    force: bool = False,
) -> PlannedForm:
    """Choose checkpoint and file; nothing is written.

    Raises:
        SettingsError: One of them cannot be used.
        NotAvailable: A converter is not installed.
    """
    check_converter(form)
    suffix = SUFFIXES[form]
    if out is not None and not out.is_dir() and out.suffix.casefold() != suffix:
        raise SettingsError(
            f"--out {out} does not end in {suffix}.", remedy=f"Name a folder or a {suffix} file."
        )
    if out is not None and not out.is_dir():
        refuse_existing(out, force=force)  # before the model is read, which takes longer
    source = read_export_source(settings, selection)
    name = f"{source.file_name}-chk{source.chosen.number}{suffix}"
    path = Path(name) if out is None else out / name if out.is_dir() else out
    for written in _paths(form, path):
        refuse_existing(written, force=force)
    beside = metadata_path(path)
    if not (beside.is_file() and beside.read_bytes() == _metadata(source)):
        refuse_existing(beside, force=force)  # a policy in another form may have brought the same
    return PlannedForm(form, source, path, fp16)


def export_form(planned: PlannedForm) -> FormReport:
    """Write the policy, once it gave the same actions as PyTorch.

    Raises:
        SettingsError: It did not, or cannot be written.
        NotAvailable: A converter or engine is not installed.
    """
    source, path = planned.source, planned.path
    origin = f"{source.chosen.name} of {source.url}"
    written = write_form(planned.form, source.design, source.weights, origin, fp16=planned.fp16)
    contents = {metadata_path(path): _metadata(source)}
    contents |= {path.with_suffix(end): data for end, data in written.files.items()}
    for each, data in contents.items():
        rewrite(each, data)
    compared = written.compared
    return FormReport(
        form=planned.form,
        prefix=source.prefix,
        checkpoint=source.chosen.name,
        file=str(path),
        files=[str(each) for each in contents],
        size_bytes=sum(map(len, contents.values())),
        engine=written.engine,
        frames=compared.frames,
        same_actions=compared.same_actions,
        greatest_difference=compared.greatest_difference,
    )


def _paths(form: Form, path: Path) -> list[Path]:
    return [path, path.with_suffix(".bin")] if form == "openvino" else [path]


def _metadata(source: ExportSource) -> bytes:
    return source.design.files[keys.MODEL_METADATA_FILE]


# Turns our checkpoints into files of the reference's.


META = ".meta"


@dataclass(frozen=True)
class TrainingCheckpoint:
    """A checkpoint as the reference's trainer has it.

    Attributes:
        parts: By the ends of their names.
        graph: `model_<N>.pb`.
        notes: For the racer.
    """

    parts: dict[str, bytes]
    graph: bytes
    variables: int
    notes: list[str]


def encode_training_checkpoint(
    weights: bytes, origin: str, metadata: ModelMetadata, parameters: Hyperparameters
) -> TrainingCheckpoint:
    """SettingsError if the reference has no such network, or the weights do not fit."""
    spec = policy_spec(metadata, parameters)
    refuse_other_networks(spec, is_sac=not metadata.algorithm.in_reference)
    model = build_policy(metadata, parameters)
    load_weights(model, weights, origin)
    arrays = weights_of(model)
    variables = reference_variables(arrays, spec, metadata.sensor)
    nodes = policy_nodes(arrays, spec, metadata.sensor)
    parts = encode_reference_checkpoint(variables)
    parts[META] = encode_meta_graph(nodes, variables)
    notes = export_notes(arrays, spec)
    return TrainingCheckpoint(parts, encode_graph(nodes), len(variables), notes)


# Exports a checkpoint for the reference simulator.


_VERIFIED = (
    "The files were read back, and the {variables} variables in them have the names and shapes of "
    "the reference simulator's list for {network}.",
    "When drcli was developed, TensorFlow 2.12 restored such files of every network and both kinds "
    "of actions; layers built under the reference's names computed the same actions and values.",
)
_NOT_VERIFIED = ("The reference simulator itself has not loaded this checkpoint.",)


@dataclass(frozen=True)
class CheckpointExport:
    source: ExportSource
    items: list[Item]
    score: Score
    notes: list[str]
    verified: list[str]


@dataclass(frozen=True)
class ExportReport:
    """The result of `dr-export tf-checkpoint` and `dr-export droa`."""

    source: Annotated[str, "The model, as an s3:// address."]
    checkpoint: Annotated[str, "Name of the exported checkpoint."]
    target: Annotated[str, "Folder or s3:// address."]
    files: Annotated[list[str], "Names of the files there."]
    size_bytes: Annotated[int, "Their size."]
    archive: Annotated[str | None, "The same files as an archive; None without one."] = None
    notes: Annotated[list[str], "What a racer should know."] = field(default_factory=list)
    verified: Annotated[list[str], "What was checked."] = field(default_factory=list)
    not_verified: Annotated[list[str], "What was not, because it needs the other system."] = field(
        default_factory=list
    )

    def view(self) -> View:
        size = f"{counted(len(self.files), 'file')}, {size_text(self.size_bytes)}"
        beside = self.archive is not None and self.archive != self.target
        return [
            f"Exported {self.checkpoint} of {self.source} to {self.target}: {size}.",
            beside and f"The same files as an archive: {self.archive}",
            *(f"Note: {note}" for note in self.notes),
            *(f"Verified: {text}" for text in self.verified),
            *(f"Not verified: {text}" for text in self.not_verified),
        ]


def read_checkpoint_export(
    settings: Settings, selection: Selection, prepare: Prepare = unchanged
) -> CheckpointExport:
    """Make the files in memory; DrError if the reference cannot use them."""
    return checkpoint_export(settings, prepare(read_export_source(settings, selection)))


def checkpoint_export(settings: Settings, source: ExportSource) -> CheckpointExport:
    """See `read_checkpoint_export`."""
    design, name = source.design, source.chosen.name
    written = encode_training_checkpoint(
        source.weights, source.origin, design.metadata, design.parameters
    )
    items = [Item(f"model/{name}{part}", data) for part, data in written.parts.items()]
    items += [
        Item(f"model/model_{source.chosen.number}.pb", written.graph),
        Item("model/checkpoint", checkpoint_state(name)),
        Item(METADATA, design.files[keys.MODEL_METADATA_FILE]),
        Item(HYPERPARAMETERS, design.files[keys.HYPERPARAMETERS_FILE]),
    ]
    reward = reward_function(settings, source.prefix)
    if reward is not None:
        items.append(Item(keys.REWARD_FUNCTION_FILE, reward))
    network = design.metadata.neural_network
    verified = [text.format(variables=written.variables, network=network) for text in _VERIFIED]
    score = reference_score(source.chosen.score)
    return CheckpointExport(source, items, score, [*source.notes, *written.notes], verified)


def export_checkpoint(
    exported: CheckpointExport, target: ExportTarget, progress: Progress
) -> ExportReport:
    """Write the files, the pointers last.

    Raises:
        DrError: It failed; the target has no pointers, or its old files.
    """
    write_items(target, exported.items, exported.score, progress)
    return report_of(exported, target.shown)


def report_of(exported: CheckpointExport, target: str) -> ExportReport:
    items = [*exported.items, *pointer_items(exported.score)]
    return ExportReport(
        source=exported.source.url,
        checkpoint=exported.source.chosen.name,
        target=target,
        files=sorted(item.name for item in items),
        size_bytes=sum(len(item.data) for item in items),
        notes=exported.notes,
        verified=exported.verified,
        not_verified=list(_NOT_VERIFIED),
    )


def checkpoint_state(name: str) -> bytes:
    """The file in which TensorFlow and the old console look."""
    return f'model_checkpoint_path: "{name}"\nall_model_checkpoint_paths: "{name}"\n'.encode()


def reward_function(settings: Settings, prefix: str) -> bytes | None:
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    places = [keys.reward_function(prefix)]
    if prefix == settings.model.prefix:
        places.append(settings.model.reward_key)
    key = next(filter(bucket.exists, places), None)
    return None if key is None else bucket.get(key)
