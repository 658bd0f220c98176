"""Notices in one form for all clouds, and the metadata service of a machine that gives them.

Its address is link-local: no proxy, and an answer takes milliseconds or does not come.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Any, Literal, Protocol
from urllib.parse import urlsplit

from drcli.base.errors import SettingsError, StorageError
from drcli.base.installation import lazy_imports

with lazy_imports():
    from http import client as http_client
    from urllib import error as urllib_error
    from urllib import request as urllib_request

Kind = Literal["interruption", "rebalance"]

TIMEOUT_S = 1.0
"""As EC2's own libraries."""

LARGEST_ANSWER = 1 << 20

LEAVING_S = 60.0
"""Assumed for an end announced without a time."""


@dataclass(frozen=True)
class Notice:
    """Something takes this machine away, or may do so soon.

    Attributes:
        source: Name of a cloud, "command" or "signal".
        kind: "interruption" is certain, "rebalance" a recommendation.
    """

    source: str
    kind: Kind
    action: str
    seconds_left: float | None
    text: str


class NoticeSource(Protocol):
    name: str

    def ask(self) -> list[Notice]:
        """What is announced now.

        Raises:
            MetadataSilent: No usable answer.
        """

    def is_spot(self) -> bool:
        """Whether this machine may be taken away.

        Raises:
            MetadataSilent: No usable answer.
        """


@dataclass(frozen=True)
class Cloud:
    """A module in `providers` has one, as `CLOUD`.

    Attributes:
        name: In DR_INTERRUPTION_WATCH.
        title: For people.
        variable: With the address of its metadata service; machines that have it are its own.
        owns: By the texts in `registry.DMI_FOLDER` by name.
        source: By the environment and an address, which may be empty. None if the environment
            forbids asking. Raises SettingsError if the address is wrong.
    """

    name: str
    title: str
    variable: str
    owns: Callable[[Mapping[str, str]], bool]
    source: Callable[[Mapping[str, str], str], NoticeSource | None]


def moment(value: object) -> float | None:
    from email.utils import parsedate_to_datetime

    text = str(value or "")
    for read in (datetime.fromisoformat, parsedate_to_datetime):
        try:
            found = read(text)
        except (ValueError, TypeError, IndexError):
            continue
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    return None


class MetadataSilent(StorageError):
    """The metadata service gives no usable answer."""


@dataclass(frozen=True)
class MetadataResponse:
    """`headers` have names in lower case."""

    status: int
    body: bytes
    headers: Mapping[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        return self.body.decode("utf-8", "replace").strip()

    def now(self, otherwise: float) -> float:
        """Unix seconds of the service, whose clock may be better."""
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

    def ask(self, path: str, headers: Mapping[str, str], method: str = "GET") -> MetadataResponse:
        """Raises MetadataSilent without an answer in time."""

        class Stay(urllib_request.HTTPRedirectHandler):
            """Keeps tokens from login pages of hotels, which redirect everything."""

            def redirect_request(self, *_: Any) -> None:
                return None

        opener = urllib_request.build_opener(urllib_request.ProxyHandler({}), Stay)
        request = urllib_request.Request(
            f"{self._address}/{path}", headers=dict(headers), method=method
        )
        try:
            try:
                answer = opener.open(request, timeout=self._timeout_s)
            except urllib_error.HTTPError as error:
                answer = error
            with answer:
                found = {name.lower(): value for name, value in answer.headers.items()}
                return MetadataResponse(answer.status or 0, answer.read(LARGEST_ANSWER), found)
        except urllib_error.URLError as error:
            raise silent(f"at {self._address} does not answer ({error.reason})") from error
        except (OSError, http_client.HTTPException, ValueError) as error:
            raise silent(f"at {self._address} does not answer ({error})") from error


def checked_address(address: str) -> str:
    """Raises SettingsError for anything but an HTTP address."""
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
