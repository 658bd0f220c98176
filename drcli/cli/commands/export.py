"""`dr export`."""

import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import Problem, SettingsError, refuse
from drcli.base.files import refuse_existing, safe_name
from drcli.base.installation import lazy_imports
from drcli.cli import prompts, terminal
from drcli.cli.options import (
    DryRun,
    Force,
    Keep,
    MaxMb,
    Replace,
    World,
    best_option,
    checkpoint_choice,
    checkpoint_option,
    prefix_option,
)
from drcli.cli.show import show
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.convert.policy_file import Form
    from drcli.transfer.export_car import CarExport
    from drcli.transfer.export_model import ExportSource, Prepare, Selection

with lazy_imports():
    from drcli.checks import compare_on_drive
    from drcli.train import distillation
    from drcli.transfer import export_car as transfer_export_car
    from drcli.transfer import export_droa, export_forms, export_model, upload


app = typer.Typer(
    no_args_is_help=True,
    help="Write a model in the form of other systems.\n\nExample: dr-export car -b",
)


# Options that the exports of a checkpoint share.


ExportBest = Annotated[bool, best_option("Export")]
ExportNumber = Annotated[str | None, checkpoint_option("Export")]
ExportPrefix = Annotated[str | None, prefix_option("Export this model instead.")]


def selection(best: bool, number: str | None, prefix: str | None) -> "Selection":
    """The checkpoint that the options choose.

    Raises:
        BadParameter: -b and -c are both given, or -c names none.
    """
    return export_model.Selection(checkpoint_choice(best, number, "best"), prefix)


# `dr export car` and `dr upload-car-zip`.


_Best = Annotated[bool, best_option("Take")]
_Number = Annotated[str | None, checkpoint_option("Take")]


@app.command("car")
def export_car(
    best: _Best = False,
    number: _Number = None,
    prefix: Annotated[str | None, prefix_option("Take this model instead.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="File or folder to write to; NAME.tar.gz if left out."),
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(
            "--check", metavar="FILE", help="Only check this archive, which anybody may have made."
        ),
    ] = None,
    force: Replace = False,
) -> None:
    """Write the archive that the physical car loads, and show what the car makes of the model.

    The archive is a file such as model-1.tar.gz in the current folder, with a frozen TensorFlow
    graph and the metadata. Takes the best checkpoint unless -c chooses another. The archive
    is checked by the rules of the car, and its graph is compared with the weights on camera frames
    of a short drive; what the car would refuse is not written (exit code 3). --check also tells in
    how many camera frames the car's gray overlay changes the action.

    Example: dr-export car
    """
    if check is not None:
        if best or number is not None or prefix or out or force:
            raise typer.BadParameter("--check takes a file, and no other option with it.")
        _check(check)
        return
    if out is not None and not out.is_dir():
        refuse_existing(out, force=force)
    loaded = settings()
    source = export_model.read_export_source(loaded, selection(best, number, prefix))
    path = transfer_export_car.archive_path(out, source.file_name, force=force)
    report = transfer_export_car.write_archive(_made(loaded, source, path.name), path)
    _warn(report.problems)
    show(report)
    terminal.suggest(
        [
            (shlex.join(["dr-car", "upload", str(path)]), "send it to the car"),
            ("dr docs car-guide", "read how to drive it there, from the calibration on"),
        ],
        elsewhere=True,
    )


def upload_car_zip(
    force: Force = False,
    best: _Best = False,
    number: _Number = None,
    prefix: Annotated[
        str | None, prefix_option("Take this model instead, under its own name.")
    ] = None,
    local: Annotated[
        bool, typer.Option("-L", "--local", help="Upload to the local bucket.")
    ] = False,
    numbered: Annotated[
        bool,
        typer.Option("-n", "--numbered", help="Also keep it under a name with the checkpoint."),
    ] = False,
    only_numbered: Annotated[
        bool,
        typer.Option("--only-numbered", help="Like -n, but not under the plain name of the model."),
    ] = False,
    keep: Keep = None,
    max_mb: MaxMb = None,
    dry_run: DryRun = False,
) -> None:
    """Upload the archive that the physical car loads.

    It goes below DR_UPLOAD_S3_PREFIX in DR_UPLOAD_S3_BUCKET under two names: carfile.tar.gz, and
    that of the model, such as model-1.tar.gz. With -n, a third one has the number of the
    checkpoint, such as model-1-chk12.tar.gz; --keep and --max-mb are about those. Checks everything
    that `dr-export car` checks. The model may be training at the same time.

    Example: dr-upload-car-zip -fL
    """
    loaded = settings()
    chosen = export_model.Selection(
        checkpoint_choice(best, number), prefix
    )  # the last one, as there
    if dry_run:
        terminal.say("*** DRYRUN MODE ***")
    target = transfer_export_car.plan_car_upload(
        loaded,
        prefix,
        local=local,
        dry_run=dry_run,
        retention=upload.retention_of(loaded, keep, max_mb),
    )
    source = export_model.read_export_source(loaded, chosen)
    if terminal.as_json:
        terminal.say(source.chosen.line)
    else:
        terminal.write(f"{source.chosen.line}\n")  # on stdout, where scripts look for it
    terminal.say(
        f"Uploading the car archive of {source.url} to {target.url}/{transfer_export_car.CAR_FILE}"
    )
    if not dry_run:
        prompts.agree("Are you sure?", yes=force)
    names = transfer_export_car.upload_names(source, numbered=numbered, only_numbered=only_numbered)
    export = _made(loaded, source, names[1])
    progress = partial(terminal.progress, unit="bytes")
    report = transfer_export_car.upload_archive(export, target, names, progress, dry_run=dry_run)
    _warn(report.problems)
    show(report)


def _made(loaded: "Settings", source: "ExportSource", file_name: str) -> "CarExport":
    with terminal.waiting("Writing the graph and comparing it with the weights on a drive ..."):
        return compare_on_drive.made_car_archive(loaded, source, file_name)


def _check(path: Path) -> None:
    try:
        race = settings().race
    except SettingsError:  # the check needs no working folder
        race = None
    report = compare_on_drive.checked_archive(path, race)
    _warn(report.warnings)
    show(report)
    refuse(report.errors)


def _warn(problems: "list[Problem]") -> None:
    for problem in problems:
        if problem.severity == "warning":
            terminal.warn(f"{problem} {problem.remedy}")
        elif problem.severity == "note":
            terminal.say(f"Note: {problem}")


# `dr export pb`, `onnx`, `tflite` and `openvino`.


_Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="FILE", help="File or folder; NAME-chkN if left out."),
]


@app.command()
def pb(
    out: _Out = None,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    force: Replace = False,
) -> None:
    """Write a frozen TensorFlow graph, which the car, OpenVINO and TensorFlow read.

    The file is run and compared with PyTorch before it is kept; its model_metadata.json is written
    beside it. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export pb --out policy.pb
    """
    _export("pb", out, best, number, prefix, force)


@app.command()
def onnx(
    out: _Out = None,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    force: Replace = False,
) -> None:
    """Write an ONNX file, which onnxruntime and most other engines read.

    Pictures are grey values from 0 to 255 of shape (batch, 120, 160, cameras). The file is run by
    onnxruntime and compared with PyTorch before it is kept; its model_metadata.json is written
    beside it. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export onnx --out policy.onnx
    """
    _export("onnx", out, best, number, prefix, force)


@app.command()
def tflite(
    out: _Out = None,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    force: Replace = False,
) -> None:
    """Write a TensorFlow Lite file with the settings of the car: weights in half precision.

    TensorFlow converts it. The file is run and compared with PyTorch before it is kept; its
    model_metadata.json is written beside it. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export tflite --out policy.tflite
    """
    _export("tflite", out, best, number, prefix, force)


@app.command()
def openvino(
    out: _Out = None,
    fp16: Annotated[
        bool, typer.Option("--fp16", help="Store weights in half precision, half the size.")
    ] = False,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    force: Replace = False,
) -> None:
    """Write OpenVINO's two files, .xml and .bin.

    The files are run by OpenVINO and compared with PyTorch before they are kept; the
    model_metadata.json is written beside them. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export openvino --out policy.xml
    """
    _export("openvino", out, best, number, prefix, force, fp16=fp16)


def _export(
    form: "Form",
    out: Path | None,
    best: bool,
    number: str | None,
    prefix: str | None,
    force: bool,
    *,
    fp16: bool = False,
) -> None:
    chosen = selection(best, number, prefix)
    target = None if out is None else out.expanduser()
    planned = export_forms.plan_form(settings(), chosen, form, target, fp16=fp16, force=force)
    report = export_forms.export_form(planned)
    show(report)
    terminal.suggest([(f"dr-evaluate --model {report.file}", "drive laps with it")])


# `dr export tf-checkpoint` and `dr export droa`.


_Local = Annotated[
    bool, typer.Option("-L", "--local", help="The bucket of --out is at the local server.")
]


Distil = Annotated[
    bool,
    typer.Option(
        "--distill", help="Give it a network that every league takes, which learns from the model."
    ),
]
Seed = Annotated[
    int | None,
    typer.Option("--seed", metavar="S", min=0, max=2**32 - 1, help="Seed of --distill."),
]


def _preparation(loaded: "Settings", distill: bool, seed: int | None) -> "Prepare":
    if not distill:
        if seed is not None:
            raise typer.BadParameter("--seed is for --distill.")
        return export_model.unchanged
    return partial(_distilled, loaded, seed or 0)


def _distilled(loaded: "Settings", seed: int, source: "ExportSource") -> "ExportSource":
    """The model with a network of the reference's; nothing is written."""
    design = source.design
    if not distillation.is_needed(design):
        network = design.metadata.neural_network
        terminal.say(f"--distill is not needed: every league takes {network}.")
        return source
    terminal.say("The new network learns, which takes some minutes. Ctrl-C ends it.")
    made = distillation.distil(
        source.races(loaded),
        loaded.run.train,
        design,
        source.weights,
        source.chosen.name,
        seed=seed,
        say=terminal.say,
    )
    return source.with_network(made.design, made.weights, str(made))


@app.command("tf-checkpoint")
def tf_checkpoint(
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            metavar="PLACE",
            help="A folder, or s3://bucket/prefix; NAME-tf-checkpoint if left out.",
        ),
    ] = None,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    local: _Local = False,
    distill: Distil = False,
    seed: Seed = None,
    force: Replace = False,
) -> None:
    """Write a TensorFlow checkpoint, from which the reference simulator evaluates and trains on.

    The folder is laid out like a model of DeepRacer-for-Cloud. Names and shapes of all variables
    are compared with the reference's before anything is written. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export tf-checkpoint --out s3://bucket/team/model-1
    """
    loaded, chosen = settings(), selection(best, number, prefix)
    source = chosen.prefix or loaded.model_prefix
    place = out or f"{safe_name(source)}-tf-checkpoint"
    target = export_model.export_target(loaded, place, source, local=local, force=force)
    exported = export_forms.read_checkpoint_export(
        loaded, chosen, _preparation(loaded, distill, seed)
    )
    report = export_forms.export_checkpoint(
        exported, target, partial(terminal.progress, unit="bytes")
    )
    show(report)


@app.command()
def droa(
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            metavar="PLACE",
            help="A folder, beside which NAME.tar.gz is written; a file that ends with .tar.gz; or "
            "s3://bucket/prefix. NAME-droa if left out.",
        ),
    ] = None,
    world: World = None,
    best: ExportBest = False,
    number: ExportNumber = None,
    prefix: ExportPrefix = None,
    local: _Local = False,
    distill: Distil = False,
    seed: Seed = None,
    force: Replace = False,
) -> None:
    """Write the folder and the archive that DeepRacer on AWS imports.

    Track and direction come from the model's training_params.yaml. Exports the best checkpoint
    unless -c chooses another.

    Example: dr-export droa --out my-model
    """
    loaded, chosen = settings(), selection(best, number, prefix)
    source = chosen.prefix or loaded.model_prefix
    place = out or f"{safe_name(source)}-droa"
    target, archive = None, None
    if place.endswith((".tar.gz", ".tgz")) and not export_model.is_url(place):
        archive = Path(place).expanduser()
    else:
        target = export_model.export_target(loaded, place, source, local=local, force=force)
        if target.folder is not None:
            archive = target.folder.with_name(f"{target.folder.name}.tar.gz")
    if archive is not None:
        refuse_existing(archive, force=force)
    exported = export_droa.read_droa_export(
        loaded, chosen, world, _preparation(loaded, distill, seed)
    )
    report = export_droa.export_droa(
        exported, target, archive, partial(terminal.progress, unit="bytes")
    )
    show(report)
    if target is not None and target.folder is not None:
        import_it = f"dr-droa import --from {shlex.quote(place)}"
        terminal.suggest([(import_it, "import it into DeepRacer on AWS")])
