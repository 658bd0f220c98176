"""`dr export pb`, `onnx`, `tflite` and `openvino`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.cli import console
from drcli.cli.export_options import (
    ExportBest,
    ExportNumber,
    ExportPrefix,
    selection,
)
from drcli.cli.options import AsJson, Replace
from drcli.cli.views import forms_view
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.formats.policy_file import Form

_Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="FILE", help="File or folder; NAME-chkN if left out."),
]


def pb(
    out: _Out = None,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    force: Replace = False,
    as_json: AsJson = False,
) -> None:
    """Write a frozen TensorFlow graph, which the car, OpenVINO and TensorFlow read.

    The file is run and compared with PyTorch before it is kept; its model_metadata.json is written
    beside it. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export pb --out policy.pb
    """
    _export("pb", out, best, number, prefix, force, as_json)


def onnx(
    out: _Out = None,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    force: Replace = False,
    as_json: AsJson = False,
) -> None:
    """Write an ONNX file, which onnxruntime and most other engines read.

    Pictures are grey values from 0 to 255 of shape (batch, 120, 160, cameras). The file is run by
    onnxruntime and compared with PyTorch before it is kept; its model_metadata.json is written
    beside it. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export onnx --out policy.onnx
    """
    _export("onnx", out, best, number, prefix, force, as_json)


def tflite(
    out: _Out = None,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    force: Replace = False,
    as_json: AsJson = False,
) -> None:
    """Write a TensorFlow Lite file with the settings of the car: weights in half precision.

    TensorFlow converts it. The file is run and compared with PyTorch before it is kept; its
    model_metadata.json is written beside it. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export tflite --out policy.tflite
    """
    _export("tflite", out, best, number, prefix, force, as_json)


def openvino(
    out: _Out = None,
    fp16: Annotated[
        bool, typer.Option("--fp16", help="Store weights in half precision, half the size.")
    ] = False,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    force: Replace = False,
    as_json: AsJson = False,
) -> None:
    """Write OpenVINO's two files, .xml and .bin.

    The files are run by OpenVINO and compared with PyTorch before they are kept; the
    model_metadata.json is written beside them. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export openvino --out policy.xml
    """
    _export("openvino", out, best, number, prefix, force, as_json, fp16=fp16)


def _export(
    form: "Form",
    out: Path | None,
    best: bool,
    number: str | None,
    prefix: str | None,
    force: bool,
    as_json: bool,
    *,
    fp16: bool = False,
) -> None:
    from drcli.models.export_forms import export_form, plan_form

    chosen = selection(best, number, prefix)
    target = None if out is None else out.expanduser()
    planned = plan_form(settings(), chosen, form, target, fp16=fp16, force=force)
    report = export_form(planned)
    console.emit(report, forms_view.exported(report), as_json=as_json)
    console.suggest([(f"dr-evaluate --model {report.file}", "drive laps with it")])
