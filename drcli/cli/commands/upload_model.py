"""`dr upload-model`."""

from functools import partial
from typing import Annotated, Literal

import typer

from drcli.cli import candidates, console, prompts
from drcli.cli.options import AsJson, DryRun, Force, prefix_option, wipe_option
from drcli.cli.views import models_view
from drcli.cli.working_folder import settings


def upload_model(
    force: Force = False,
    best: Annotated[bool, typer.Option("-b", "--best", help="Copy the best checkpoint.")] = False,
    number: Annotated[
        int | None,
        typer.Option(
            "-c",
            "--checkpoint",
            metavar="N",
            min=0,
            help="Copy checkpoint N.",
            autocompletion=candidates.checkpoints,
        ),
    ] = None,
    prefix: Annotated[
        str | None, prefix_option("Copy this model instead, under its own name.")
    ] = None,
    to: Annotated[
        str | None, typer.Option("--to", metavar="PREFIX", help="Name at the target.")
    ] = None,
    local: Annotated[bool, typer.Option("-L", "--local", help="Copy to the local bucket.")] = False,
    increment: Annotated[
        bool, typer.Option("-1", "--increment", help="Raise the number in the target's name first.")
    ] = False,
    wipe: Annotated[bool, wipe_option("Delete earlier uploads at the target.")] = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Copy a checkpoint, with all files that belong to it, to the upload bucket.

    The target is DR_UPLOAD_S3_PREFIX in DR_UPLOAD_S3_BUCKET, with the keys of DR_UPLOAD_S3_PROFILE
    and DR_UPLOAD_S3_ENDPOINT_URL if it is not at Amazon. Copies the last checkpoint unless -b or -c
    chooses another. The model may be training at the same time.

    Example: dr-upload-model -b -f
    """
    from drcli.models.upload import UploadOptions, plan_upload, upload
    from drcli.models.upload_prefix import plan_upload_increment

    if best and number is not None:
        raise typer.BadParameter("-b and -c both choose a checkpoint; use only one.")
    if increment and (prefix or to):
        raise typer.BadParameter("-1 changes the name that -p or --to replaces; use only one.")
    loaded = settings()
    step = None
    if increment:
        step = plan_upload_increment(loaded)  # written once the upload is there
        loaded = step.settings
    by_name: Literal["best", "last"] = "best" if best else "last"
    choice = by_name if number is None else number
    options = UploadOptions(choice, prefix, to, local, wipe, dry_run)
    if dry_run:
        console.say("*** DRYRUN MODE ***")
    planned = plan_upload(loaded, options)
    if step is not None:
        console.say(f"Incrementing model from {step.step.before} to {step.step.after}")
    if as_json:
        console.say(planned.chosen.line)
    else:
        console.write(f"{planned.chosen.line}\n")  # on stdout, where scripts look for it
    console.say(f"Uploading {planned.source_url} to {planned.target_url}")
    if not dry_run:
        prompts.agree("Are you sure?", yes=force)
    report = upload(planned, loaded, partial(console.progress, unit="bytes"))
    if step is not None and not dry_run:
        step.edit.make()  # last: an upload that was interrupted continues under the same name
    console.emit(report, models_view.upload(report), as_json=as_json)
    if not dry_run:
        console.suggest(
            [
                ("dr-list-models" if local else "dr-list-models --upload", "list the models there"),
                (
                    f"dr-download-model{' -L' if local else ''} -s {report.target} -t NAME",
                    "copy it back under another name",
                ),
            ]
        )
