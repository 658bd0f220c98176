"""`dr download-model`."""

from functools import partial
from typing import Annotated

import typer

from drcli.cli import console, prompts
from drcli.cli.options import AsJson, DryRun, Force, prefix_option, wipe_option
from drcli.cli.views import models_view
from drcli.cli.views.layout import counted
from drcli.cli.working_folder import settings


def download_model(
    source: Annotated[
        str | None,
        typer.Option(
            "-s", "--source", metavar="URL", help="The model to copy: s3://bucket/prefix."
        ),
    ] = None,
    target: Annotated[str | None, prefix_option("Its name here.", "-t", "--target")] = None,
    force: Force = False,
    wipe: Annotated[
        bool, wipe_option("Delete files at the target that are not part of it.")
    ] = False,
    dry_run: DryRun = False,
    custom_files: Annotated[
        bool,
        typer.Option("-c", "--custom-files", help="Also copy its three files to custom_files/."),
    ] = False,
    local: Annotated[
        bool, typer.Option("-L", "--local", help="Copy from a bucket of the local server.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Copy a model from another bucket to the local one.

    Uses the keys of DR_UPLOAD_S3_PROFILE, and DR_UPLOAD_S3_ENDPOINT_URL if the bucket is not at
    Amazon. With -c, files in custom_files/ that differ are kept as NAME.bak; an experiment has a
    custom_files/ of its own.

    Example: dr-download-model -s s3://bucket/team/model-1 -t model-1
    """
    from drcli.models.download import DownloadOptions, download, plan_download

    if not source:
        raise typer.BadParameter("No source URL to download model from. Give it with -s.")
    if not target:
        raise typer.BadParameter("No target prefix defined. Exiting. Give it with -t.")
    loaded = settings()
    options = DownloadOptions(source, target, local, wipe, dry_run, custom_files)
    if dry_run:
        console.say("*** DRYRUN MODE ***")
    planned = plan_download(loaded, options)
    console.say(f"Downloading {planned.source_url} to {planned.target_url}")
    if planned.used:
        there = counted(planned.used, "file")
        console.warn(f"{planned.target_url} is not empty: {there}.")
    if not dry_run:
        prompts.agree("Are you sure?", yes=force)
    report = download(planned, loaded, partial(console.progress, unit="bytes"))
    console.emit(report, models_view.download(report), as_json=as_json)
    if not dry_run:
        name = planned.options.prefix
        model = f"DR_LOCAL_S3_MODEL_PREFIX={name}"
        driving = [
            (f"{model} dr-evaluate", "drive it"),
            (f"{model} dr-start-training --resume", "continue its training"),
            (f"dr-list-models {name}", "show its checkpoints"),
        ]
        console.suggest(driving if report.checkpoint else [("dr-list-models", "list all models")])
