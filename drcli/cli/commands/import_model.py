"""`dr import`."""

import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drcli.base.errors import DrError
from drcli.base.installation import lazy_imports
from drcli.base.report import counted
from drcli.cli import prompts, terminal
from drcli.cli.commands.copy_model import copy_here
from drcli.cli.options import (
    CustomFiles,
    DryRun,
    Force,
    World,
    parsed_checkpoint,
    prefix_option,
    wipe_option,
)
from drcli.cli.show import show
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.records.evaluation_task import CarTrials
    from drcli.transfer.import_model import ImportedModel

with lazy_imports():
    from drcli.run import car_trials
    from drcli.transfer import find_checkpoint
    from drcli.transfer import import_model as transfer_import_model


def import_model(
    source: Annotated[
        str,
        typer.Argument(metavar="SOURCE", help="A file, folder or archive, or s3://bucket/prefix."),
    ],
    target: Annotated[str | None, prefix_option("Its name here.", "-t", "--target")] = None,
    force: Force = False,
    wipe: Annotated[bool, wipe_option("Delete a model of that name first.")] = False,
    dry_run: DryRun = False,
    best: Annotated[
        bool, typer.Option("-b", "--best", help="Import its best checkpoint, not its last.")
    ] = False,
    number: Annotated[
        str | None,
        typer.Option(
            "--checkpoint", metavar="WHICH", help="Import this one: a number, last, best."
        ),
    ] = None,
    metadata: Annotated[
        Path | None,
        typer.Option(
            "--metadata", metavar="FILE", help="Use this model_metadata.json, not the source's."
        ),
    ] = None,
    world: World = None,
    drive: Annotated[
        bool, typer.Option("--drive/--no-drive", help="Try the cars of all years afterwards.")
    ] = True,
    custom_files: CustomFiles = False,
    local: Annotated[
        bool, typer.Option("-L", "--local", help="SOURCE is a bucket of the local server.")
    ] = False,
) -> None:
    """Make a model of another system a model here: it drives, trains on and can be exported.

    SOURCE can be a frozen graph (.pb), a TensorFlow checkpoint (any of its files), an .onnx of
    dr-export, an archive of a console, of DeepRacer on AWS or of the car (.tar.gz, .zip), or a
    model's folder, on this machine or in a bucket. Buckets are read as by dr-download-model. A
    folder or archive of a model of drcli is copied as it is.

    Example: dr-import model_30.pb --metadata model_metadata.json -t team/model-30
    """
    if not target:
        raise typer.BadParameter("No target prefix defined. Exiting. Give it with -t.")
    if best and number is not None:
        raise typer.BadParameter("-b and --checkpoint both choose a checkpoint; use only one.")
    loaded = settings()
    chosen = parsed_checkpoint(number)
    wanted: Literal["last", "best"] | int | None = "best" if best else None
    if chosen is not None:
        if not (isinstance(chosen, int) or chosen == "last" or chosen == "best"):
            raise typer.BadParameter(
                f"--checkpoint {chosen}: models of other systems have no milestones. Give a "
                "number, last or best."
            )
        wanted = chosen
    options = transfer_import_model.ImportOptions(
        source, target, wanted, metadata, world, local, wipe, dry_run, custom_files
    )
    try:
        with terminal.waiting("Reading and comparing the model ..."):
            planned = transfer_import_model.plan_import(loaded, options)
    except find_checkpoint.OwnModel:
        copy_here(transfer_import_model.copy_of_own(loaded, options), force=force)
        return
    if dry_run:
        terminal.say("*** DRYRUN MODE ***")
    terminal.say(f"Importing {planned.report.source} to {planned.report.target}")
    terminal.warn(*planned.report.warnings)
    if planned.used:
        terminal.warn(f"{planned.report.target} is not empty: {counted(planned.used, 'file')}.")
        if not dry_run:
            prompts.agree("Are you sure?", yes=force)
    report = transfer_import_model.import_model(
        planned, loaded, partial(terminal.progress, unit="bytes")
    )
    if drive and not dry_run:
        report = replace(report, trials=_tried(loaded, planned.options.prefix, report))
    show(report)
    if not dry_run:
        model = f"DR_LOCAL_S3_MODEL_PREFIX={planned.options.prefix}"
        given = {"--metadata": metadata, "--checkpoint": number, "--world": world}
        named = [word for name, text in given.items() if text for word in (name, str(text))]
        flags = ["-cf", "--no-drive", *["-b"] * best, *["-L"] * local]
        again = shlex.join(["dr-import", source, "-t", target, *named, *flags])
        terminal.suggest(
            [
                (f"{model} dr-evaluate", "drive it"),
                *([(again, "copy its files to custom_files/ first")] if report.other_files else []),
                (f"{model} dr-start-training --resume", "continue its training"),
                (f"dr-list-models {planned.options.prefix}", "show its checkpoints"),
            ]
        )


def _tried(loaded: "Settings", prefix: str, model: "ImportedModel") -> "CarTrials | None":
    try:
        own = car_trials.settings_of_model(loaded, prefix, model.world)
        with terminal.waiting(f"Trying the cars of all years on {model.world} ..."):
            return car_trials.try_cars(own, model.checkpoint)
    except DrError as error:  # the model is imported all the same
        terminal.warn(f"The cars were not tried: {error} {error.remedy}")
        return None
