"""`dr local-aws`."""

import os
import shutil

import typer

from drcli.base.errors import NotAvailable
from drcli.cli.working_folder import settings


def local_aws(context: typer.Context) -> None:
    """Run the aws command on the bucket of your settings.

    Adds the address, the keys or the profile, and the region, and starts the local server if it is
    needed. All arguments are passed to aws. The exit code is that of aws.

    Example: dr-local-aws s3 ls s3://bucket/
    """
    from drcli.runs.aws_command import aws_command

    program = shutil.which("aws")
    if program is None:
        raise NotAvailable(
            "The program aws is not on the PATH.",
            remedy="Install it in its own environment, for example with `pipx install awscli` or "
            "`uv tool install awscli`.",
        )
    arguments, environment = aws_command(settings().storage, context.args, os.environ)
    os.execve(program, ["aws", *arguments], environment)
