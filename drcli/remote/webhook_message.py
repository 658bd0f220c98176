"""Posts to a webhook of Slack, Discord, Mattermost or one's own."""

from typing import Any
from urllib.parse import urlsplit

from drcli.base.errors import StorageError
from drcli.remote.web_request import USER_AGENT, explain

SETTING = "DR_WEBHOOK_URL"

_LONGEST = 1900
"""Discord takes 2,000."""


def host_of(url: str) -> str:
    """The rest of the address is a secret."""
    return urlsplit(url).hostname or "?"


def body_of(event: str, subject: str, text: str, facts: dict[str, Any]) -> dict[str, Any]:
    """Slack and Mattermost show `text`, Discord `content`.

    Names of models cannot call people: Slack's signs are escaped, and Discord is told not to look
    for any.
    """
    shown = f"{subject}\n{text}"[:_LONGEST]
    escaped = shown.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return {
        "text": escaped,
        "content": shown,
        "allowed_mentions": {"parse": []},
        "event": event,
        "facts": facts,
    }


def post(url: str, body: dict[str, Any], timeout_s: float) -> None:
    """Redirections would get the message, so they are not followed.

    Raises:
        StorageError: The server refuses, or does not answer.
    """
    import requests

    try:
        answer = requests.post(
            url,
            json=body,
            timeout=timeout_s,
            allow_redirects=False,
            headers={"User-Agent": USER_AGENT},
            # Otherwise requests would send a password from ~/.netrc.
            auth=lambda prepared: prepared,
        )
    except (requests.exceptions.InvalidURL, ValueError) as error:
        raise StorageError(
            f"{SETTING} cannot be used: {type(error).__name__}.",
            remedy=f"Correct {SETTING} in system.env.",
        ) from None  # its text contains the address
    except requests.RequestException as error:
        raise explain(error, f"https://{host_of(url)}", SETTING) from None
    if not 200 <= answer.status_code < 300:
        raise StorageError(
            f"The webhook at {host_of(url)} answered with status {answer.status_code}.",
            remedy=f"Check {SETTING} in system.env; it may have been withdrawn.",
        )
