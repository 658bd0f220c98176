"""Exports a checkpoint as a policy for other engines: pb, onnx, tflite, openvino."""

from dataclasses import dataclass
from pathlib import Path

from drcli.base.atomic_file import rewrite
from drcli.base.errors import SettingsError
from drcli.base.replaceable import refuse_existing
from drcli.config.settings import Settings
from drcli.exchange.policy_source import Runtime
from drcli.formats.policy_file import Form, metadata_path
from drcli.models.export_model import ExportSource, Selection, read_export_source
from drcli.store import keys

SUFFIXES: dict[Form, str] = {
    "pb": ".pb",
    "onnx": ".onnx",
    "openvino": ".xml",
    "tflite": ".tflite",
}


@dataclass(frozen=True)
class FormReport:
    """What was written, and how it was verified.

    Attributes:
        form: pb, onnx, openvino or tflite.
        prefix: The model.
        checkpoint: Its checkpoint.
        file: The file that `dr-evaluate --model` takes.
        files: All files, with that one.
        size_bytes: Of all of them.
        engine: What ran the file to compare it with PyTorch.
        frames: Pictures that were compared.
        same_actions: Share with the same likeliest action; 1 for continuous actions.
        greatest_difference: Of a probability, or of a continuous action.
    """

    form: Form
    prefix: str
    checkpoint: str
    file: str
    files: list[str]
    size_bytes: int
    engine: Runtime
    frames: int
    same_actions: float
    greatest_difference: float


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
    from drcli.formats.policy_engines import check_converter

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
    from drcli.formats.write_form import write_form

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
