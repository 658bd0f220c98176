"""`dr start-worker`."""

import os
import re
from typing import Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.working_folder import settings_or_defaults, working_folder

with lazy_imports():
    from drcli.run import join_training


def _place(text: str) -> tuple[str, str]:
    found = re.fullmatch(r"s3://([^/]+)/(.+?)/*", text)
    if found is None:
        raise typer.BadParameter(
            f"{text:.80} does not name a model. Write s3://BUCKET/PREFIX, with the "
            "DR_LOCAL_S3_BUCKET and DR_LOCAL_S3_MODEL_PREFIX of the training."
        )
    return found[1], found[2]


def start_worker(
    join: Annotated[
        str,
        typer.Option("--join", metavar="MODEL", help="s3://BUCKET/PREFIX of the training."),
    ],
    endpoint_url: Annotated[
        str | None,
        typer.Option(
            "--endpoint-url", metavar="URL", help="Address of the S3 server, if not Amazon's."
        ),
    ] = None,
    profile: Annotated[
        str | None, typer.Option("--profile", metavar="NAME", help="AWS profile with the keys.")
    ] = None,
    region: Annotated[
        str | None, typer.Option("--region", metavar="REGION", help="Region of the bucket.")
    ] = None,
    wait: Annotated[
        bool,
        typer.Option("--wait", help="Wait for the training to begin."),
    ] = False,
    no_take_over: Annotated[
        bool,
        typer.Option(
            "--no-take-over",
            help="Wait if the machine of the training is gone, instead of going on here.",
        ),
    ] = False,
    end_with_parent: Annotated[
        bool,
        typer.Option(
            "--end-with-parent", help="End when the process that has started this one ends."
        ),
    ] = False,
) -> None:
    """Drive for a training that runs on another machine.

    This machine needs the same version of drcli and the keys to the bucket, and nothing else: the
    reward function and all settings of the training come from the bucket. A worker may join and
    leave at any time; the episodes of an iteration are shared by those who are there. If the
    machine of the training is gone for a minute, one of the others goes on with it.

    Without --endpoint-url, --profile and --region, the bucket is that of system.env in this folder;
    in a folder without run.env, it is Amazon's. DR_THREADS limits the cores.

    Ends with the training. Ctrl-C or SIGTERM leave it, and the others go on.

    Example: dr-start-worker --join s3://bucket/rl-deepracer-sagemaker --wait
    """
    bucket, prefix = _place(join)
    flags = {"DR_LOCAL_S3_BUCKET": bucket, "DR_LOCAL_S3_MODEL_PREFIX": prefix}
    if endpoint_url is not None:
        flags |= {"DR_CLOUD": "remote", "DR_REMOTE_MINIO_URL": endpoint_url}
    elif not (working_folder() / "run.env").exists():
        flags |= {"DR_CLOUD": "aws"}
    if profile is not None:
        flags |= {"DR_LOCAL_S3_PROFILE": profile}
    if region is not None:
        flags |= {"DR_AWS_APP_REGION": region}
    settings = settings_or_defaults(flags)

    report = join_training.join_training(
        settings,
        prefix,
        waits=wait,
        takes_over=not no_take_over,
        say=terminal.say,
        ends_with=os.getppid() if end_with_parent else None,
    )
    terminal.emit(report, report.message)
    raise typer.Exit(report.code)
