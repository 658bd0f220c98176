"""`dr upload-model`."""

from functools import partial
from typing import Annotated, Literal

import typer

from drcli.cli.options import AsJson, DryRun, Force
from drcli.cli.working_folder import settings


def upload_model(
    force: Force = False,
    best: Annotated[bool, typer.Option("-b", "--best", help="The best checkpoint.")] = False,
    number: Annotated[
        int | None,
        typer.Option("-c", "--checkpoint", metavar="N", min=0, help="Checkpoint N."),
    ] = None,
    prefix: Annotated[
        str | None,
        typer.Option("-p", "--prefix", help="Another model; it keeps its name at the target."),
    ] = None,
    to: Annotated[
        str | None, typer.Option("--to", metavar="PREFIX", help="Another name at the target.")
    ] = None,
    local: Annotated[bool, typer.Option("-L", "--local", help="Into the local bucket.")] = False,
    increment: Annotated[
        bool, typer.Option("-1", "--increment", help="Raise the number of the upload first.")
    ] = False,
    wipe: Annotated[
        bool, typer.Option("-w", "--wipe", help="Delete checkpoints of earlier uploads there.")
    ] = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Copy a checkpoint, with all that belongs to it, to the bucket of uploads.

    That is DR_UPLOAD_S3_PREFIX in DR_UPLOAD_S3_BUCKET, reached with DR_UPLOAD_S3_PROFILE, at
    DR_UPLOAD_S3_ENDPOINT_URL if it is not Amazon. The last checkpoint is taken unless -b or -c
    chooses another. The model may be training meanwhile.

    Example: dr-upload-model -b -f
    """
    from drcli.cli import console, prompts
    from drcli.cli.views import models_view
    from drcli.models.upload import UploadOptions, plan_upload, upload
    from drcli.models.upload_prefix import plan_upload_increment

    if best and number is not None:
        raise typer.BadParameter("-b and -c each choose a checkpoint; give one of them.")
    if increment and (prefix or to):
        raise typer.BadParameter("-1 raises the name that -p or --to would replace.")
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
        step.edit.make()  # last: an upload that was interrupted goes on where it was
    console.emit(report, models_view.upload(report), as_json=as_json)
    if not dry_run:
        console.suggest(
            [
                ("dr-list-models" if local else "dr-list-models --upload", "what lies there"),
                (
                    f"dr-download-model{' -L' if local else ''} -s {report.target} -t NAME",
                    "fetch it under another name",
                ),
            ]
        )
