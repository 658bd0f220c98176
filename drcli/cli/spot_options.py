"""Options and account of the `dr-spot` commands."""

from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import SettingsError
from drcli.cli.working_folder import settings, working_folder
from drcli.run.stack_plan import account_of

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.outside.aws.aws_account import Account

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
    return account_of(loaded, region, profile)
