"""Options and connection of all `droa-*` commands."""

import inspect
import sys
import time
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Annotated, Any, Concatenate, ParamSpec

import typer

from drcli.cli import console, prompts
from drcli.cli.working_folder import settings
from drcli.config import secret_environment

if TYPE_CHECKING:
    from drcli.remote.droa_api import Droa
    from drcli.remote.droa_session import DroaSession
    from drcli.remote.droa_site import SiteOptions

P = ParamSpec("P")

pause: Callable[[float], None] = time.sleep
_PANEL: tuple[tuple[str, str], ...] = (
    ("url", "Address of DeepRacer on AWS, instead of DR_DROA_URL."),
    ("username", "User, instead of DR_DROA_USERNAME."),
    ("password", "Password; without it you are asked, which keeps it out of the history."),
    ("region", "AWS region, instead of the one in env.js."),
    ("user_pool_id", "Cognito user pool, instead of the one in env.js."),
    ("user_pool_client_id", "Cognito client, instead of the one in env.js."),
    ("identity_pool_id", "Cognito identity pool, instead of the one in env.js."),
    ("api_endpoint", "Address of the interface, instead of the one in env.js."),
    ("upload_bucket", "Bucket for imports, instead of the one in env.js."),
)


class Connection:
    """Connects only when a command is ready for it."""

    def __init__(self, given: dict[str, str | None]) -> None:
        self._given = given

    def refuse_no_site(self) -> None:
        """Refuse a missing site before anything slow.

        Raises:
            SettingsError: The address is missing or wrong.
        """
        from drcli.remote.droa_site import refuse_no_site

        refuse_no_site(self._site_options(), settings().droa.url)

    def session(self) -> "DroaSession":
        """The user, before any request but env.js.

        Raises:
            DrError: A setting is missing or wrong, or env.js cannot be read.
        """
        return self._connect().session

    def droa(self) -> "Droa":
        """The interface, as this user.

        Raises:
            DrError: As for `session`.
        """
        return self._connect()

    def _connect(self) -> "Droa":
        from drcli.remote.droa_api import Droa
        from drcli.remote.droa_session import DroaSession
        from drcli.remote.droa_site import URL_SETTING, find_site
        from drcli.remote.web_request import Web

        config = settings().droa
        web = Web(
            "--url" if self._given["url"] else URL_SETTING,
            pause=lambda seconds: pause(seconds),
            trace=_trace if config.debug else None,
        )
        site = find_site(self._site_options(), config.url, config.aws_endpoint_url, web)
        username = self._given["username"] or config.username
        return Droa(DroaSession(site, username, lambda: self._password(username), _code), web)

    def _site_options(self) -> "SiteOptions":
        from drcli.remote.droa_site import SiteOptions

        given = {n: v for n, v in self._given.items() if n not in ("username", "password")}
        return SiteOptions(**given)

    def _password(self, username: str) -> str:
        from drcli.remote.droa_site import PASSWORD_VARIABLE

        known = self._given["password"] or secret_environment.all_secrets().get(PASSWORD_VARIABLE)
        return known or prompts.secret(
            f"Password for {username}",
            "Run the command on a terminal, or give the password on standard input or in the "
            f"variable {PASSWORD_VARIABLE}.",
        )


def connected(
    command: Callable[Concatenate[Connection, P], None],
) -> Callable[P, None]:
    """Gives a command these options, and the connection as first parameter."""
    signature = inspect.signature(command)

    @wraps(command)
    def run(*args: P.args, **named: P.kwargs) -> None:
        given: dict[str, Any] = {name: named.pop(name, None) for name, _ in _PANEL}
        command(Connection(given), *args, **named)

    kind = inspect.Parameter.KEYWORD_ONLY
    shared = [
        inspect.Parameter(name, kind, default=None, annotation=_option(name, text))
        for name, text in _PANEL
    ]
    own = [each.replace(kind=kind) for each in list(signature.parameters.values())[1:]]
    vars(run)["__signature__"] = signature.replace(parameters=[*own, *shared])
    return run


def _option(name: str, text: str) -> Any:
    flag = f"--{name.replace('_', '-')}"
    return Annotated[str | None, typer.Option(flag, metavar="TEXT", help=text)]


def _code(question: str) -> str:
    return prompts.secret(question, "Run the command on a terminal.")


def _trace(line: str) -> None:
    console.err.print(line, markup=False, soft_wrap=True)
    sys.stderr.flush()
