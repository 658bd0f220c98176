"""`dr download-model`."""

from functools import partial
from typing import Annotated

import typer

from drcli.cli.options import AsJson, DryRun, Force
from drcli.cli.working_folder import settings


def download_model(
    source: Annotated[
        str | None,
        typer.Option("-s", "--source", metavar="URL", help="The model, as s3://bucket/prefix."),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option("-t", "--target", metavar="PREFIX", help="What to call it here."),
    ] = None,
    force: Force = False,
    wipe: Annotated[
        bool, typer.Option("-w", "--wipe", help="Delete what lies there and is no part of it.")
    ] = False,
    dry_run: DryRun = False,
    custom_files: Annotated[
        bool,
        typer.Option("-c", "--custom-files", help="Copy its three files into custom_files/ too."),
    ] = False,
    local: Annotated[
        bool, typer.Option("-L", "--local", help="The bucket is one of the local server.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Fetch a model from another bucket into the local one.

    The bucket is reached with DR_UPLOAD_S3_PROFILE, at DR_UPLOAD_S3_ENDPOINT_URL if it is not
    Amazon. With -c the files in custom_files/ that were different stay as NAME.bak; an experiment
    has its own custom_files/.

    Example: dr-download-model -s s3://bucket/team/model-1 -t model-1
    """
    from drcli.cli import console, prompts
    from drcli.cli.views import models_view
    from drcli.models.download import DownloadOptions, download, plan_download

    if not source:
        raise typer.BadParameter("No source URL to download model from. Name it with -s.")
    if not target:
        raise typer.BadParameter("No target prefix defined. Exiting. Name it with -t.")
    loaded = settings()
    options = DownloadOptions(source, target, local, wipe, dry_run, custom_files)
    if dry_run:
        console.say("*** DRYRUN MODE ***")
    planned = plan_download(loaded, options)
    console.say(f"Downloading {planned.source_url} to {planned.target_url}")
    if planned.used:
        there = models_view.files(planned.used)
        console.warn(f"At {planned.target_url} lies something already: {there}.")
    if not dry_run:
        prompts.agree("Are you sure?", yes=force)
    report = download(planned, loaded, partial(console.progress, unit="bytes"))
    console.emit(report, models_view.download(report), as_json=as_json)
    if not dry_run:
        name = planned.options.prefix
        model = f"DR_LOCAL_S3_MODEL_PREFIX={name}"
        driving = [
            (f"{model} dr-evaluate", "drive it"),
            (f"{model} dr-start-training --resume", "go on training it"),
            (f"dr-list-models {name}", "what it holds"),
        ]
        console.suggest(driving if report.checkpoint else [("dr-list-models", "all models")])
