"""Azure: scheduled events."""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from drcli.clouds.cloud import Cloud, MetadataResponse, MetadataService, Notice, moment, silent

AZURE_ADDRESS = "http://169.254.169.254"
AZURE_ASSET_TAG = "7783-7084-3265-9085-8269-3286-77"
"""Of machines at Azure, not of others with Hyper-V. Source: cloud-init."""

AZURE_EVENTS = {"Preempt": math.inf, "Terminate": math.inf, "Redeploy": 120.0, "Reboot": 120.0}
"""Events that end processes, and how many seconds before they count: a redeployment is announced
15 minutes before, in which the machine can train.
"""


class AzureNotices:
    """Scheduled events of Azure."""

    name = "Azure"

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

    def is_spot(self) -> bool:
        path = "metadata/instance/compute/priority?api-version=2021-02-01&format=text"
        return self._read(path).text == "Spot"

    def _notice(self, event: Mapping[str, Any], answer: MetadataResponse) -> Notice | None:
        kind = str(event.get("EventType"))
        if kind not in AZURE_EVENTS or not self._concerns_this_machine(event.get("Resources")):
            return None
        when = moment(event.get("NotBefore"))
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

    def _read(self, path: str) -> MetadataResponse:
        answer = self._service.ask(path, {"Metadata": "true"})
        if answer.status != 200:
            raise silent(f"of Azure answers {answer.status} for {path.partition('?')[0]}")
        return answer


CLOUD = Cloud(
    "azure",
    AzureNotices.name,
    "",
    lambda dmi: dmi["chassis_asset_tag"] == AZURE_ASSET_TAG,
    lambda environment, address: AzureNotices(MetadataService(address or AZURE_ADDRESS)),
)
