"""Requests to other tools' servers, with JSON answers."""

import os
from typing import Any

import requests
from urllib3.exceptions import LocationParseError

from drcli.base.connection_cause import cause_of
from drcli.config import secret_environment

TIMEOUT_S = 10.0
"""The training does not wait."""


class ServerError(Exception):
    """A server refuses or is away; `code` is its own name of the error, or empty."""

    def __init__(self, text: str, code: str = "") -> None:
        super().__init__(text)
        self.code = code


class ServerRequests:
    """To a server of a kind such as `MLflow`; empty headers are left out."""

    def __init__(self, base: str, kind: str, headers: dict[str, str]) -> None:
        self._base, self._kind = base, kind
        self._session = requests.Session()
        self._session.trust_env = False  # no user of ~/.netrc, and no proxy that nobody named
        self._session.headers.update({name: text for name, text in headers.items() if text})

    def ask(self, method: str, what: str, **options: Any) -> dict[str, Any]:
        """The JSON answer; options are those of `requests.request`.

        Raises:
            ServerError: It refuses, does not answer, or is another program.
        """
        try:
            answer = self._session.request(
                method, self._base + what, timeout=TIMEOUT_S, allow_redirects=False, **options
            )
        except requests.Timeout:
            raise ServerError(f"{what} is not answered within {TIMEOUT_S:g} s.") from None
        except (requests.RequestException, LocationParseError) as error:
            raise ServerError(f"the server cannot be reached: {cause_of(error)}.") from None
        try:
            found = answer.json()
        except ValueError:
            found = None
        if answer.status_code == 200 and isinstance(found, dict):
            return found
        given = found if isinstance(found, dict) else {"message": f"it is no {self._kind} server"}
        reason = str(given.get("message") or given.get("error")).rstrip(".")
        raise ServerError(
            f"{what} was answered with {answer.status_code}: {reason}.",
            str(given.get("error_code", "")),
        )

    def close(self) -> None:
        self._session.close()


def variable(name: str) -> str:
    """Of the environment, or kept from the racer's code."""
    return secret_environment.all_secrets().get(name) or os.environ.get(name, "")
