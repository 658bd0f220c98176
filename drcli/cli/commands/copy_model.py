"""`dr upload-model` and `dr download-model`."""

from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.base.report import counted
from drcli.cli import prompts, terminal
from drcli.cli.options import (
    CustomFiles,
    DryRun,
    Force,
    Keep,
    MaxMb,
    best_option,
    checkpoint_choice,
    checkpoint_option,
    prefix_option,
    wipe_option,
)
from drcli.cli.show import show
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.transfer.download import DownloadOptions

with lazy_imports():
    from drcli.transfer import download, upload


def upload_model(
    force: Force = False,
    best: Annotated[bool, best_option("Copy")] = False,
    number: Annotated[str | None, checkpoint_option("Copy")] = None,
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
    keep: Keep = None,
    max_mb: MaxMb = None,
    dry_run: DryRun = False,
) -> None:
    """Copy a checkpoint, with all files that belong to it, to the upload bucket.

    The target is DR_UPLOAD_S3_PREFIX in DR_UPLOAD_S3_BUCKET, with the keys of DR_UPLOAD_S3_PROFILE
    and DR_UPLOAD_S3_ENDPOINT_URL if it is not at Amazon. Copies the last checkpoint unless -b or -c
    chooses another. The model may be training at the same time.

    Example: dr-upload-model -b -f
    """
    choice = checkpoint_choice(best, number)
    if increment and (prefix or to):
        raise typer.BadParameter("-1 changes the name that -p or --to replaces; use only one.")
    loaded = settings()
    step = None
    if increment:
        step = upload.plan_upload_increment(loaded)  # written once the upload is there
        loaded = step.settings
    options = upload.UploadOptions(choice, prefix, to, local, wipe, dry_run, keep, max_mb)
    if dry_run:
        terminal.say("*** DRYRUN MODE ***")
    planned = upload.plan_upload(loaded, options)
    if step is not None:
        terminal.say(f"Incrementing model from {step.step.before} to {step.step.after}")
    if terminal.as_json:
        terminal.say(planned.chosen.line)
    else:
        terminal.write(f"{planned.chosen.line}\n")  # on stdout, where scripts look for it
    terminal.say(f"Uploading {planned.source_url} to {planned.target_url}")
    if dry_run:
        terminal.say("A dry run writes nothing, so it does not test the permission to write there.")
    else:
        prompts.agree("Are you sure?", yes=force)
    report = upload.upload(planned, loaded, partial(terminal.progress, unit="bytes"))
    if step is not None and not dry_run:
        step.edit.make()  # last: an upload that was interrupted continues under the same name
    show(report)
    if not dry_run:
        listing = "dr-list-models" if local else "dr-list-models --upload"
        back = f"dr-download-model{' -L' if local else ''} -s {report.target} -t NAME"
        copy_back = (back, "copy it back under another name")
        terminal.suggest([(listing, "list the models there"), copy_back])


def download_model(
    source: Annotated[
        str | None,
        typer.Option(
            "-s",
            "--source",
            metavar="URL",
            help="The model to copy: s3://bucket/prefix, or its folder or archive on this machine.",
        ),
    ] = None,
    target: Annotated[str | None, prefix_option("Its name here.", "-t", "--target")] = None,
    force: Force = False,
    wipe: Annotated[
        bool, wipe_option("Delete files at the target that are not part of it.")
    ] = False,
    dry_run: DryRun = False,
    custom_files: CustomFiles = False,
    local: Annotated[
        bool, typer.Option("-L", "--local", help="Copy from a bucket of the local server.")
    ] = False,
) -> None:
    """Copy a model from another bucket to the local one.

    Uses the keys of DR_UPLOAD_S3_PROFILE, and DR_UPLOAD_S3_ENDPOINT_URL if the bucket is not at
    Amazon. With -c, files in custom_files/ that differ are kept as NAME.bak; an experiment
    has its own custom_files/.

    Example: dr-download-model -s s3://bucket/team/model-1 -t model-1
    """
    if not source:
        raise typer.BadParameter("No source URL to download model from. Give it with -s.")
    if not target:
        raise typer.BadParameter("No target prefix defined. Exiting. Give it with -t.")
    options = download.DownloadOptions(source, target, local, wipe, dry_run, custom_files)
    copy_here(options, force=force)


def copy_here(options: "DownloadOptions", *, force: bool) -> None:
    """Copy a model to the local bucket, and show what was copied."""
    loaded, dry_run = settings(), options.dry_run
    if dry_run:
        terminal.say("*** DRYRUN MODE ***")
    planned = download.plan_download(loaded, options)
    terminal.say(f"Downloading {planned.source_url} to {planned.target_url}")
    if planned.used:
        terminal.warn(f"{planned.target_url} is not empty: {counted(planned.used, 'file')}.")
    if not dry_run:
        prompts.agree("Are you sure?", yes=force)
    report = download.download(planned, loaded, partial(terminal.progress, unit="bytes"))
    show(report)
    if not dry_run:
        name = planned.options.prefix
        model = f"DR_LOCAL_S3_MODEL_PREFIX={name}"
        driving = [
            (f"{model} dr-evaluate", "drive it"),
            (f"{model} dr-start-training --resume", "continue its training"),
            (f"dr-list-models {name}", "show its checkpoints"),
        ]
        terminal.suggest(driving if report.checkpoint else [("dr-list-models", "list all models")])
