"""Asks the metadata service of a cloud machine.

Its address is link-local: no proxy, and an answer takes milliseconds or does not come.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drcli.base.errors import SettingsError, StorageError

TIMEOUT_S = 1.0
"""As EC2's own libraries."""

LARGEST_ANSWER = 1 << 20


class MetadataSilent(StorageError):
    """The metadata service gives no usable answer."""


@dataclass(frozen=True)
class Answer:
    """`headers` have names in lower case."""

    status: int
    body: bytes
    headers: Mapping[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        return self.body.decode("utf-8", "replace").strip()

    def now(self, otherwise: float) -> float:
        """Unix seconds of the service, whose clock may be better."""
        from email.utils import parsedate_to_datetime

        try:
            return parsedate_to_datetime(self.headers["date"]).timestamp()
        except (KeyError, ValueError, TypeError):
            return otherwise

    def object(self) -> dict[str, Any]:
        """Raises MetadataSilent if the body is not a JSON object."""
        try:
            found = json.loads(self.body)
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise silent(f"answers with {self.text[:40]!r} instead of a JSON object")
        return found


def silent(how: str) -> MetadataSilent:
    return MetadataSilent(
        f"The metadata service {how}.",
        remedy="Set DR_INTERRUPTION_WATCH=off if this machine has none.",
    )


class MetadataService:
    def __init__(self, address: str, timeout_s: float = TIMEOUT_S) -> None:
        self._address = checked_address(address)
        self._timeout_s = timeout_s

    def ask(self, path: str, headers: Mapping[str, str], method: str = "GET") -> Answer:
        """Raises MetadataSilent without an answer in time."""
        import http.client
        from urllib.error import HTTPError, URLError
        from urllib.request import HTTPRedirectHandler, ProxyHandler, Request, build_opener

        class Stay(HTTPRedirectHandler):
            """Keeps tokens from login pages of hotels, which redirect everything."""

            def redirect_request(self, *_: Any) -> None:
                return None

        opener = build_opener(ProxyHandler({}), Stay)
        request = Request(f"{self._address}/{path}", headers=dict(headers), method=method)
        try:
            try:
                answer = opener.open(request, timeout=self._timeout_s)
            except HTTPError as error:
                answer = error
            with answer:
                found = {name.lower(): value for name, value in answer.headers.items()}
                return Answer(answer.status or 0, answer.read(LARGEST_ANSWER), found)
        except URLError as error:
            raise silent(f"at {self._address} does not answer ({error.reason})") from error
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise silent(f"at {self._address} does not answer ({error})") from error


def checked_address(address: str) -> str:
    """Raises SettingsError for anything but an HTTP address."""
    from urllib.parse import urlsplit

    stripped = address.strip().rstrip("/")
    try:
        parts = urlsplit(stripped)
        valid = parts.scheme in ("http", "https") and bool(parts.hostname)
        _ = parts.port
    except ValueError:
        valid = False
    if not valid or any(letter.isspace() for letter in stripped):
        raise SettingsError(
            f"{address!r} is not the address of a metadata service.",
            remedy="Write it as in http://127.0.0.1:1338, or unset "
            "AWS_EC2_METADATA_SERVICE_ENDPOINT, GCE_METADATA_HOST and DR_METADATA_SERVICE_URL.",
        )
    return stripped
