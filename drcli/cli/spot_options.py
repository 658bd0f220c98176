"""Options and account of the `dr-spot` commands."""

import os
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import SettingsError
from drcli.bucket.endpoint import read_profile
from drcli.cli.working_folder import settings, working_folder
from drcli.config.value_types import HOME_REGION
from drcli.outside.aws.aws_account import PROFILE_SETTING, Account

if TYPE_CHECKING:
    from drcli.config.settings import Settings

StackName = Annotated[str, typer.Argument(metavar="STACK", help="Name of the stack.")]
Region = Annotated[
    str | None,
    typer.Option("--region", metavar="TEXT", help="AWS region, instead of DR_AWS_APP_REGION."),
]
Profile = Annotated[
    str | None,
    typer.Option("--profile", metavar="TEXT", help="AWS profile, instead of DR_LOCAL_S3_PROFILE."),
]
Yes = Annotated[bool, typer.Option("-y", "--yes", "-f", "--force", help="Do not ask; answer yes.")]


def account(region: str | None, profile: str | None, loaded: "Settings | None" = None) -> "Account":
    """The account of these options, else of the settings, else of the AWS files."""
    if loaded is None and (working_folder() / "run.env").is_file():
        try:
            loaded = settings()
        except SettingsError:
            # Wrong settings must not keep anybody from seeing and ending what costs money.
            loaded = None
    own = None
    if loaded is not None and loaded.cloud == "aws":
        own = loaded.profile or None
    chosen = profile or own
    if not region and loaded is not None and "DR_AWS_APP_REGION" in loaded.sources:
        region = loaded.aws_app_region
    return Account(region or usual_region(chosen), chosen)


def usual_region(profile: str | None) -> str:
    """The AWS command's region, else Amazon's first."""
    named = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")
    return named or read_profile(profile, PROFILE_SETTING).region or HOME_REGION
