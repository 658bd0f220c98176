"""`dr local-aws`."""

import os
import shutil
from collections.abc import Mapping, Sequence

import typer

from drcli.base.errors import NotAvailable
from drcli.bucket.server import server
from drcli.cli.working_folder import settings
from drcli.config.run_config import StorageConfig

# Arguments and variables of the aws command for the bucket.


_COMPATIBLE = {
    # Not all other servers know Amazon's newer checksums.
    "AWS_REQUEST_CHECKSUM_CALCULATION": "when_required",
    "AWS_RESPONSE_CHECKSUM_VALIDATION": "when_required",
}

_OTHER_KEYS = ("AWS_PROFILE", "AWS_DEFAULT_PROFILE", "AWS_SESSION_TOKEN", "AWS_SECURITY_TOKEN")


def aws_command(
    storage: StorageConfig,
    arguments: Sequence[str],
    environ: Mapping[str, str],
) -> tuple[list[str], dict[str, str]]:
    """May start the local server. Keys are variables: every user can read a command line."""
    endpoint = server.ensure_running(storage)
    options: list[str] = []
    variables = {**environ, "AWS_DEFAULT_REGION": endpoint.region}
    if endpoint.url is not None:
        options += ["--endpoint-url", endpoint.url]
        variables |= _COMPATIBLE
    if endpoint.access_key is not None and endpoint.secret_key is not None:
        variables = {name: value for name, value in variables.items() if name not in _OTHER_KEYS}
        variables["AWS_ACCESS_KEY_ID"] = endpoint.access_key
        variables["AWS_SECRET_ACCESS_KEY"] = endpoint.secret_key
    elif endpoint.profile is not None:
        options += ["--profile", endpoint.profile]
    return [*options, *arguments], variables


def local_aws(context: typer.Context) -> None:
    """Run the aws command on the bucket of your settings.

    Adds the address, the keys or the profile, and the region, and starts the local server if it is
    needed. All arguments are passed to aws. The exit code is that of aws.

    Example: dr-local-aws s3 ls s3://bucket/
    """
    program = shutil.which("aws")
    if program is None:
        raise NotAvailable(
            "The program aws is not on the PATH.",
            remedy="Install it in its own environment, for example with `pipx install awscli` or "
            "`uv tool install awscli`.",
        )
    arguments, environment = aws_command(settings().storage, context.args, os.environ)
    os.execve(program, ["aws", *arguments], environment)
