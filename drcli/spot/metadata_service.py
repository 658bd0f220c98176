"""Asks the metadata service of a cloud machine for notices: Amazon EC2, Google, Azure.

A service is at a link-local address that only the machine itself reaches. So there is no proxy on
the way, and an answer takes milliseconds or does not come.
"""

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from drcli.base.errors import SettingsError, StorageError
from drcli.spot.cloud_notices import CLOUD_NAMES, Cloud, Notice, NoticeSource

TIMEOUT_S = 1.0
"""How long an answer may take. EC2's own libraries wait as long."""

LARGEST_ANSWER = 1 << 20

EC2_IPV4, EC2_IPV6 = "http://169.254.169.254", "http://[fd00:ec2::254]"
GOOGLE_HOST = "metadata.google.internal"
AZURE_ADDRESS = "http://169.254.169.254"

TOKEN_S = 21_600
"""How long a token of EC2 is asked to live: the longest time allowed."""

TOKEN_RENEW_S = 0.5 * TOKEN_S

EC2_NOTICE_S = 120.0
"""Between the notice of an interruption and the interruption. Source: the EC2 user guide."""

GOOGLE_NOTICE_S = 30.0
"""The same at Google, after which the machine is switched off. Source: Compute Engine docs."""

GOOGLE_MAINTENANCE_S = 60.0
"""Between the announcement of maintenance that ends the machine, and that end."""

LEAVING_S = 60.0
"""Assumed where a service announces the end of a machine without a time."""

HIBERNATE_S = 10.0
"""An instance that hibernates gets its notice when that begins."""

AZURE_EVENTS = {"Preempt": math.inf, "Terminate": math.inf, "Redeploy": 120.0, "Reboot": 120.0}
"""Events that end the processes of a machine, and how many seconds before they count: a
redeployment is announced a quarter of an hour before, and until then the machine can train."""


class MetadataSilent(StorageError):
    """The metadata service does not answer, or not as it should."""


@dataclass(frozen=True)
class Answer:
    """What a service answered.

    Attributes:
        status: Of HTTP.
        headers: Their names in lower case.
    """

    status: int
    body: bytes
    headers: Mapping[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The body as text."""
        return self.body.decode("utf-8", "replace").strip()

    def now(self, otherwise: float) -> float:
        """Unix seconds by the clock of the service, which may be better set than ours."""
        from email.utils import parsedate_to_datetime

        try:
            return parsedate_to_datetime(self.headers["date"]).timestamp()
        except (KeyError, ValueError, TypeError):
            return otherwise

    def object(self) -> dict[str, Any]:
        """The body as a JSON object.

        Raises:
            MetadataSilent: It is none.
        """
        try:
            found = json.loads(self.body)
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise _silent(f"answers with {self.text[:40]!r} instead of a JSON object")
        return found


def _silent(how: str) -> MetadataSilent:
    return MetadataSilent(
        f"The metadata service {how}.",
        remedy="Set DR_INTERRUPTION_WATCH=off if this machine has none.",
    )


class MetadataService:
    """A metadata service at an address such as http://169.254.169.254."""

    def __init__(self, address: str, timeout_s: float = TIMEOUT_S) -> None:
        self._address = checked_address(address)
        self._timeout_s = timeout_s

    def ask(self, path: str, headers: Mapping[str, str], method: str = "GET") -> Answer:
        """Send one request.

        Raises:
            MetadataSilent: There is no answer in time.
        """
        import http.client
        from urllib.error import HTTPError, URLError
        from urllib.request import HTTPRedirectHandler, ProxyHandler, Request, build_opener

        class Stay(HTTPRedirectHandler):
            """A hotel's login page redirects everything; the token must not go there."""

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
            raise _silent(f"at {self._address} does not answer ({error.reason})") from error
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise _silent(f"at {self._address} does not answer ({error})") from error


def checked_address(address: str) -> str:
    """An address without a slash at its end.

    Raises:
        SettingsError: It is no address of the web.
    """
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


class Ec2Notices:
    """Notices of Amazon EC2, read with the tokens of IMDSv2.

    Args:
        service: Its metadata service.
        clock: Unix seconds, for tests.
    """

    name = CLOUD_NAMES["aws"]

    def __init__(self, service: MetadataService, clock: Callable[[], float] = time.time) -> None:
        self._service = service
        self._clock = clock
        self._token = ""
        self._token_s = -math.inf

    def ask(self) -> list[Notice]:
        """An interruption, the end of the instance in its group, and a recommendation to move."""
        found = []
        action = self._read("latest/meta-data/spot/instance-action")
        if action is not None:
            found.append(self._interruption(action))
        state = self._read("latest/meta-data/autoscaling/target-lifecycle-state")
        if state is not None and state.text == "Terminated":
            text = "EC2 announces that the Auto Scaling group terminates this instance."
            found.append(Notice("aws", "interruption", "terminate", LEAVING_S, text))
        advice = self._read("latest/meta-data/events/recommendations/rebalance")
        if advice is not None and "noticeTime" in advice.object():
            text = "EC2 recommends another machine: this instance may soon be interrupted."
            found.append(Notice("aws", "rebalance", "rebalance", None, text))
        return found

    def _interruption(self, answer: Answer) -> Notice:
        values = answer.object()
        action = str(values.get("action") or "terminate")
        left_s = HIBERNATE_S if action == "hibernate" else EC2_NOTICE_S
        when = _moment(values.get("time"))
        if when is not None:
            left_s = min(left_s, max(0.0, when - answer.now(self._clock())))
        text = f"EC2 announces to {action} this instance in {left_s:.0f} s."
        return Notice("aws", "interruption", action, left_s, text)

    def _read(self, path: str) -> Answer | None:
        """What is at a path; None if nothing is."""
        answer = self._with_token(path)
        if answer.status == 401:  # the token has expired, or belongs to an earlier boot
            self._token_s = -math.inf
            answer = self._with_token(path)
        if answer.status == 404:
            return None
        if answer.status != 200:
            raise _silent(f"of EC2 answers {answer.status} for {path}")
        return answer

    def _with_token(self, path: str) -> Answer:
        if time.monotonic() - self._token_s > TOKEN_RENEW_S:
            ttl = {"X-aws-ec2-metadata-token-ttl-seconds": str(TOKEN_S)}
            answer = self._service.ask("latest/api/token", ttl, "PUT")
            if answer.status not in (200, 404, 405):  # those two: a service of the first version
                raise _silent(f"of EC2 gives no token (it answers {answer.status})")
            self._token = answer.text if answer.status == 200 else ""
            self._token_s = time.monotonic()
        return self._service.ask(
            path, {"X-aws-ec2-metadata-token": self._token} if self._token else {}
        )


class GoogleNotices:
    """Notices of Google Compute Engine."""

    name = CLOUD_NAMES["gcp"]

    def __init__(self, service: MetadataService) -> None:
        self._service = service

    def ask(self) -> list[Notice]:
        """The preemption of a spot machine, and maintenance that ends a machine."""
        found = []
        if self._read("instance/preempted") == "TRUE":
            text = f"Google preempts this machine; it is switched off in {GOOGLE_NOTICE_S:.0f} s."
            found.append(Notice("gcp", "interruption", "preempt", GOOGLE_NOTICE_S, text))
        if self._read("instance/maintenance-event") == "TERMINATE_ON_HOST_MAINTENANCE":
            text = "Google announces maintenance that ends this machine."
            found.append(Notice("gcp", "interruption", "terminate", GOOGLE_MAINTENANCE_S, text))
        return found

    def _read(self, path: str) -> str:
        answer = self._service.ask(f"computeMetadata/v1/{path}", {"Metadata-Flavor": "Google"})
        if answer.status == 404:
            return ""
        if answer.status != 200 or answer.headers.get("metadata-flavor") != "Google":
            raise _silent(f"of Google answers {answer.status} for {path}")
        return answer.text


class AzureNotices:
    """Scheduled events of Azure.

    Args:
        service: Its metadata service.
        clock: Unix seconds, for tests.
    """

    name = CLOUD_NAMES["azure"]

    def __init__(self, service: MetadataService, clock: Callable[[], float] = time.time) -> None:
        self._service = service
        self._clock = clock
        self._machine: str | None = None

    def ask(self) -> list[Notice]:
        """Events that end this machine or its processes."""
        answer = self._read("metadata/scheduledevents?api-version=2020-07-01")
        events = answer.object().get("Events")
        found = []
        for event in events if isinstance(events, list) else []:
            notice = self._notice(event, answer) if isinstance(event, dict) else None
            if notice is not None:
                found.append(notice)
        return found

    def _notice(self, event: Mapping[str, Any], answer: Answer) -> Notice | None:
        kind = str(event.get("EventType"))
        if kind not in AZURE_EVENTS or not self._concerns_this_machine(event.get("Resources")):
            return None
        when = _moment(event.get("NotBefore"))
        # Without a time, the event has started.
        left_s = 0.0 if when is None else max(0.0, when - answer.now(self._clock()))
        if left_s > AZURE_EVENTS[kind]:
            return None
        text = f"Azure announces the event {kind} for this machine in {left_s:.0f} s."
        return Notice("azure", "interruption", kind.lower(), left_s, text)

    def _concerns_this_machine(self, names: object) -> bool:
        """Whether an event is about us: a scale set announces those of all its machines."""
        if not isinstance(names, list) or not names:
            return True
        if self._machine is None:
            path = "metadata/instance/compute/name?api-version=2021-02-01&format=text"
            self._machine = self._read(path).text
        ours = self._machine.casefold()
        return not ours or any(str(name).casefold() == ours for name in names)

    def _read(self, path: str) -> Answer:
        answer = self._service.ask(path, {"Metadata": "true"})
        if answer.status != 200:
            raise _silent(f"of Azure answers {answer.status} for {path.partition('?')[0]}")
        return answer


def source_of(
    cloud: Cloud, environment: Mapping[str, str], address: str = ""
) -> NoticeSource | None:
    """The notices of a cloud; None if the environment forbids to ask for them.

    Args:
        cloud: Which one.
        environment: The standard variables with the address of its service count.
        address: DR_METADATA_SERVICE_URL; empty for that of the environment or the usual one.

    Raises:
        SettingsError: The address is wrong.
    """
    if cloud == "aws":
        if environment.get("AWS_EC2_METADATA_DISABLED", "").strip().casefold() == "true":
            return None
        mode = environment.get("AWS_EC2_METADATA_SERVICE_ENDPOINT_MODE", "").strip().casefold()
        usual = EC2_IPV6 if mode == "ipv6" else EC2_IPV4
        named = environment.get("AWS_EC2_METADATA_SERVICE_ENDPOINT", "").strip()
        return Ec2Notices(MetadataService(address or named or usual))
    if cloud == "gcp":
        host = environment.get("GCE_METADATA_HOST", "").strip() or GOOGLE_HOST
        return GoogleNotices(
            MetadataService(address or (host if "://" in host else f"http://{host}"))
        )
    return AzureNotices(MetadataService(address or AZURE_ADDRESS))


def _moment(value: object) -> float | None:
    """A time in one of the two forms of the services, in Unix seconds; None for anything else."""
    from email.utils import parsedate_to_datetime

    text = str(value or "")
    for read in (datetime.fromisoformat, parsedate_to_datetime):
        try:
            found = read(text)
        except (ValueError, TypeError, IndexError):
            continue
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    return None
