"""Requests to the servers of other tools, whose answers are JSON objects."""

import os
from typing import Any

import requests
from urllib3.exceptions import LocationParseError

from drcli.base.connection_cause import cause_of
from drcli.config import secret_environment

TIMEOUT_S = 10.0
"""Of a request. The training does not wait for it."""


class ServerError(Exception):
    """The server refused something, or cannot be reached; the text is the reason.

    Args:
        text: A sentence.
        code: The server's own name of the error; empty if it gave none.
    """

    def __init__(self, text: str, code: str = "") -> None:
        super().__init__(text)
        self.code = code


class ServerRequests:
    """A connection to a server.

    Args:
        base: Beginning of all addresses.
        kind: What the server should be, such as `MLflow`.
        headers: Sent with each request; those without a value are left out.
    """

    def __init__(self, base: str, kind: str, headers: dict[str, str]) -> None:
        self._base, self._kind = base, kind
        self._session = requests.Session()
        self._session.trust_env = False  # no user of ~/.netrc, and no proxy that nobody named
        self._session.headers.update({name: text for name, text in headers.items() if text})

    def ask(self, method: str, what: str, **options: Any) -> dict[str, Any]:
        """The answer of the server as a JSON object.

        Args:
            method: GET or POST.
            what: End of the address.
            options: Of `requests.request`, such as `json`.

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
        """Close the connection."""
        self._session.close()


def variable(name: str) -> str:
    """A variable of the environment, or one that was kept from the racer's code; empty if unset."""
    return secret_environment.all_secrets().get(name) or os.environ.get(name, "")
