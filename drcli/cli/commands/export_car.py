"""`dr export car` and `dr upload-car-zip`."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.replaceable import refuse_existing
from drcli.cli import console, prompts
from drcli.cli.export_options import selection
from drcli.cli.options import (
    AsJson,
    DryRun,
    Force,
    Keep,
    MaxMb,
    Replace,
    best_option,
    checkpoint_choice,
    checkpoint_option,
    prefix_option,
)
from drcli.cli.views import car_archive_view
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.base.problems import Problem
    from drcli.config.settings import Settings
    from drcli.models.export_car import CarExport
    from drcli.models.export_model import ExportSource

_Best = Annotated[bool, best_option("Take")]
_Number = Annotated[str | None, checkpoint_option("Take")]


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
    as_json: AsJson = False,
) -> None:
    """Write the archive that the physical car loads, and show what the car makes of the model.

    The archive is a file such as model-1.tar.gz in the current folder, with a frozen TensorFlow
    graph and the metadata. Takes the best checkpoint unless -c chooses another. The archive
    is checked by the rules of the car, and its graph is compared with the weights on camera frames
    of a short drive; what the car would refuse is not written (exit code 3).

    Example: dr-export car
    """
    from drcli.models.export_car import archive_path, write_archive
    from drcli.models.export_model import read_export_source

    if check is not None:
        if best or number is not None or prefix or out or force:
            raise typer.BadParameter("--check takes a file, and no other option with it.")
        _check(check, as_json=as_json)
        return
    if out is not None and not out.is_dir():
        refuse_existing(out, force=force)
    loaded = settings()
    source = read_export_source(loaded, selection(best, number, prefix))
    path = archive_path(out, source.file_name, force=force)
    report = write_archive(_made(loaded, source, path.name), path)
    _warn(report.problems)
    console.emit(report, car_archive_view.export(report), as_json=as_json)


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
    as_json: AsJson = False,
) -> None:
    """Upload the archive that the physical car loads.

    It goes below DR_UPLOAD_S3_PREFIX in DR_UPLOAD_S3_BUCKET under two names: carfile.tar.gz, and
    that of the model, such as model-1.tar.gz. With -n, a third one has the number of the
    checkpoint, such as model-1-chk12.tar.gz; --keep and --max-mb are about those. Checks everything
    that `dr-export car` checks. The model may be training at the same time.

    Example: dr-upload-car-zip -fL
    """
    from drcli.models.export_car import (
        CAR_FILE,
        plan_car_upload,
        upload_archive,
        upload_names,
    )
    from drcli.models.export_model import Selection, read_export_source
    from drcli.models.upload import retention_of

    loaded = settings()
    chosen = Selection(checkpoint_choice(best, number), prefix)  # the last one, as there
    if dry_run:
        console.say("*** DRYRUN MODE ***")
    target = plan_car_upload(
        loaded,
        prefix,
        local=local,
        dry_run=dry_run,
        retention=retention_of(loaded, keep, max_mb),
    )
    source = read_export_source(loaded, chosen)
    if as_json:
        console.say(source.chosen.line)
    else:
        console.write(f"{source.chosen.line}\n")  # on stdout, where scripts look for it
    console.say(f"Uploading the car archive of {source.url} to {target.url}/{CAR_FILE}")
    if not dry_run:
        prompts.agree("Are you sure?", yes=force)
    names = upload_names(source, numbered=numbered, only_numbered=only_numbered)
    export = _made(loaded, source, names[1])
    progress = partial(console.progress, unit="bytes")
    report = upload_archive(export, target, names, progress, dry_run=dry_run)
    _warn(report.problems)
    console.emit(report, car_archive_view.export(report), as_json=as_json)


def _made(loaded: "Settings", source: "ExportSource", file_name: str) -> "CarExport":
    from drcli.runs.car_archive_on_drive import made_car_archive

    with console.waiting("Writing the graph and comparing it with the weights on a drive ..."):
        return made_car_archive(loaded, source, file_name)


def _check(path: Path, *, as_json: bool) -> None:
    from drcli.base.problems import refuse
    from drcli.models.export_car import check_archive

    report = check_archive(path)
    _warn(report.warnings)
    console.emit(report, car_archive_view.check(report), as_json=as_json)
    refuse(report.errors)


def _warn(problems: "list[Problem]") -> None:
    for problem in problems:
        if problem.severity == "warning":
            console.warn(f"{problem} {problem.remedy}")
        elif problem.severity == "note":
            console.say(f"Note: {problem}")
