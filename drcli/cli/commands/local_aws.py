"""`dr local-aws`."""

import os
import shutil

import typer

from drcli.cli.working_folder import settings


def local_aws(context: typer.Context) -> None:
    """Run the aws command on the bucket of these settings.

    Address, keys or profile and region are filled in, the local server is started where needed;
    everything after the name goes to aws as it is, and its exit code is this one's.

    Example: dr-local-aws s3 ls s3://bucket/
    """
    from drcli.base.errors import NotAvailable
    from drcli.runs.aws_command import aws_command

    program = shutil.which("aws")
    if program is None:
        raise NotAvailable(
            "The program aws is not on the PATH.",
            remedy="Install it in an environment of its own, as with `pipx install awscli` or "
            "`uv tool install awscli`.",
        )
    arguments, environment = aws_command(settings().storage, context.args, os.environ)
    os.execve(program, ["aws", *arguments], environment)
