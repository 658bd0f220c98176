"""Interruption notices of EC2, Google and Azure."""

import math
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

from drcli.spot.cloud_notices import CLOUD_NAMES, Cloud, Notice, NoticeSource
from drcli.spot.metadata_service import (
    Answer,
    Ec2Metadata,
    MetadataService,
    ec2_metadata,
    silent,
)

GOOGLE_HOST = "metadata.google.internal"
AZURE_ADDRESS = "http://169.254.169.254"

EC2_NOTICE_S = 120.0
"""Source: EC2 user guide."""

GOOGLE_NOTICE_S = 30.0
"""Source: Compute Engine docs."""

GOOGLE_MAINTENANCE_S = 60.0
LEAVING_S = 60.0
"""Assumed for an end announced without a time."""

HIBERNATE_S = 10.0
"""The notice comes when hibernation begins."""

AZURE_EVENTS = {"Preempt": math.inf, "Terminate": math.inf, "Redeploy": 120.0, "Reboot": 120.0}
"""Events that end processes, and how many seconds before they count: a redeployment is announced
15 minutes before, in which the machine can train.
"""


class Ec2Notices:
    name = CLOUD_NAMES["aws"]

    def __init__(self, metadata: Ec2Metadata, clock: Callable[[], float] = time.time) -> None:
        self._metadata = metadata
        self._clock = clock

    def ask(self) -> list[Notice]:
        found = []
        action = self._metadata.read("spot/instance-action")
        if action is not None:
            found.append(self._interruption(action))
        state = self._metadata.read("autoscaling/target-lifecycle-state")
        if state is not None and state.text == "Terminated":
            text = "EC2 announces that the Auto Scaling group will terminate this instance."
            found.append(Notice("aws", "interruption", "terminate", LEAVING_S, text))
        advice = self._metadata.read("events/recommendations/rebalance")
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
        text = f"EC2 announces that it will {action} this instance in {left_s:.0f} s."
        return Notice("aws", "interruption", action, left_s, text)


class GoogleNotices:
    name = CLOUD_NAMES["gcp"]

    def __init__(self, service: MetadataService) -> None:
        self._service = service

    def ask(self) -> list[Notice]:
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
            raise silent(f"of Google answers {answer.status} for {path}")
        return answer.text


class AzureNotices:
    """Scheduled events of Azure."""

    name = CLOUD_NAMES["azure"]

    def __init__(self, service: MetadataService, clock: Callable[[], float] = time.time) -> None:
        self._service = service
        self._clock = clock
        self._machine: str | None = None

    def ask(self) -> list[Notice]:
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
        """A scale set announces events of all its machines."""
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
            raise silent(f"of Azure answers {answer.status} for {path.partition('?')[0]}")
        return answer


def source_of(
    cloud: Cloud, environment: Mapping[str, str], address: str = ""
) -> NoticeSource | None:
    """None if the environment forbids asking; an empty address means its own or the usual one.

    Raises:
        SettingsError: The address is wrong.
    """
    if cloud == "aws":
        metadata = ec2_metadata(environment, address)
        return None if metadata is None else Ec2Notices(metadata)
    if cloud == "gcp":
        host = environment.get("GCE_METADATA_HOST", "").strip() or GOOGLE_HOST
        return GoogleNotices(
            MetadataService(address or (host if "://" in host else f"http://{host}"))
        )
    return AzureNotices(MetadataService(address or AZURE_ADDRESS))


def _moment(value: object) -> float | None:
    from email.utils import parsedate_to_datetime

    text = str(value or "")
    for read in (datetime.fromisoformat, parsedate_to_datetime):
        try:
            found = read(text)
        except (ValueError, TypeError, IndexError):
            continue
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    return None
