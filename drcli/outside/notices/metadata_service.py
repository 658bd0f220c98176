"""Asks the metadata service of a cloud machine, and reads EC2's.

Its address is link-local: no proxy, and an answer takes milliseconds or does not come.
"""

import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from typing import Any
from urllib.parse import urlsplit

from drcli.base.errors import SettingsError, StorageError
from drcli.base.installation import lazy_imports

with lazy_imports():
    from http import client as http_client
    from urllib import error as urllib_error
    from urllib import request as urllib_request

TIMEOUT_S = 1.0
"""As EC2's own libraries."""

LARGEST_ANSWER = 1 << 20

EC2_IPV4, EC2_IPV6 = "http://169.254.169.254", "http://[fd00:ec2::254]"

TOKEN_S = 21_600
"""The longest life of an EC2 token."""

TOKEN_RENEW_S = 0.5 * TOKEN_S


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
                return Answer(answer.status or 0, answer.read(LARGEST_ANSWER), found)
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


class Ec2Metadata:
    """Reads with IMDSv2."""

    def __init__(self, service: MetadataService) -> None:
        self._service = service
        self._token = ""
        self._token_s = -math.inf

    def read(self, path: str) -> Answer | None:
        """What is below `latest/meta-data/`, or None.

        Raises:
            MetadataSilent: No usable answer in time.
        """
        answer = self._with_token(path)
        if answer.status == 401:  # the token has expired, or belongs to an earlier boot
            self._token_s = -math.inf
            answer = self._with_token(path)
        if answer.status == 404:
            return None
        if answer.status != 200:
            raise silent(f"of EC2 answers {answer.status} for {path}")
        return answer

    def _with_token(self, path: str) -> Answer:
        if time.monotonic() - self._token_s > TOKEN_RENEW_S:
            ttl = {"X-aws-ec2-metadata-token-ttl-seconds": str(TOKEN_S)}
            answer = self._service.ask("latest/api/token", ttl, "PUT")
            if answer.status not in (200, 404, 405):  # those two: a service of the first version
                raise silent(f"of EC2 gives no token (it answers {answer.status})")
            self._token = answer.text if answer.status == 200 else ""
            self._token_s = time.monotonic()
        headers = {"X-aws-ec2-metadata-token": self._token} if self._token else {}
        return self._service.ask(f"latest/meta-data/{path}", headers)


def ec2_metadata(environment: Mapping[str, str], address: str = "") -> Ec2Metadata | None:
    """None if Amazon's variables forbid it; an empty address means theirs, or the usual one.

    Raises:
        SettingsError: The address is wrong.
    """
    if environment.get("AWS_EC2_METADATA_DISABLED", "").strip().casefold() == "true":
        return None
    mode = environment.get("AWS_EC2_METADATA_SERVICE_ENDPOINT_MODE", "").strip().casefold()
    usual = EC2_IPV6 if mode == "ipv6" else EC2_IPV4
    named = environment.get("AWS_EC2_METADATA_SERVICE_ENDPOINT", "").strip()
    return Ec2Metadata(MetadataService(address or named or usual))
