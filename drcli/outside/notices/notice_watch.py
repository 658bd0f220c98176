"""Threads that watch a metadata service and the racer's program for notices."""

import math
import os
import shlex
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any, Literal, Protocol

from drcli.base.errors import DrError, SettingsError
from drcli.base.log import get_logger
from drcli.config.secret_environment import split
from drcli.outside.notices.metadata_service import (
    Answer,
    Ec2Metadata,
    MetadataService,
    ec2_metadata,
    silent,
)

# Interruption notices in one form for all clouds.


Kind = Literal["interruption", "rebalance"]

Cloud = Literal["aws", "gcp", "azure"]

CLOUD_NAMES: Mapping[Cloud, str] = {
    "aws": "Amazon EC2",
    "gcp": "Google Compute Engine",
    "azure": "Azure",
}

DMI_FOLDER = Path("/sys/class/dmi/id")
AZURE_ASSET_TAG = "7783-7084-3265-9085-8269-3286-77"
"""Of machines at Azure, not of others with Hyper-V. Source: cloud-init."""


@dataclass(frozen=True)
class Notice:
    """Something takes this machine away, or may do so soon.

    Attributes:
        source: aws, gcp, azure, "command" or "signal".
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


def cloud_of_machine(environment: Mapping[str, str], dmi: Path = DMI_FOLDER) -> Cloud | None:
    """By mainboard and environment, without network; None for other machines."""
    if environment.get("AWS_EC2_METADATA_SERVICE_ENDPOINT"):
        return "aws"
    if environment.get("GCE_METADATA_HOST"):
        return "gcp"
    vendor, product, tag, firmware = (
        _text(dmi / name)
        for name in ("sys_vendor", "product_name", "chassis_asset_tag", "bios_version")
    )
    if vendor == "Amazon EC2" or firmware.endswith(".amazon"):
        return "aws"
    if vendor == "Google" and product.startswith("Google"):
        return "gcp"
    if tag == AZURE_ASSET_TAG:
        return "azure"
    return None


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace").strip()
    except OSError:
        return ""


POLL_S = 5.0
"""As EC2 recommends."""

SILENT_POLL_S = 60.0
"""After some failures."""

SILENT_TIMES = 3

COMMAND_PAUSE_S = 5.0
COMMAND_EXIT_S = 2.0

OUTPUT_BYTES = 1 << 16

_logger = get_logger(__name__)


@dataclass(frozen=True)
class Announced:
    notice: Notice
    read_s: float

    def left_s(self, now_s: float) -> float | None:
        if self.notice.seconds_left is None:
            return None
        return max(0.0, self.notice.seconds_left - (now_s - self.read_s))


class NoticeWatch:
    def __init__(
        self,
        source: NoticeSource | None,
        command: Sequence[str] = (),
        folder: Path = Path(),
        *,
        poll_s: float = POLL_S,
        pause_s: float = COMMAND_PAUSE_S,
    ) -> None:
        self._source = source
        self._command = command
        self._folder = folder
        self._poll_s = poll_s
        self._pause_s = pause_s
        self._stopped = threading.Event()
        self._lock = threading.Lock()
        self._of_source: list[Announced] = []
        self._of_command: list[Announced] = []
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        if self._source is not None:
            threading.Thread(
                target=self._poll, args=(self._source,), name="notices", daemon=True
            ).start()
        if self._command:
            threading.Thread(target=self._run_command, name="notice command", daemon=True).start()

    def stop(self) -> None:
        self._stopped.set()
        with self._lock:
            process = self._process
        if process is not None and process.poll() is None:
            _signal_group(process, signal.SIGTERM)
            killer = threading.Timer(COMMAND_EXIT_S, _signal_group, (process, signal.SIGKILL))
            killer.daemon = True
            killer.start()

    def announced(self) -> list[Announced]:
        """A service may take notices back."""
        with self._lock:
            return [*self._of_command, *self._of_source]

    def ask_once(self) -> list[Announced]:
        """Raises MetadataSilent without a usable answer."""
        if self._source is None:
            return []
        now_s = time.monotonic()
        found = [Announced(notice, now_s) for notice in self._source.ask()]
        with self._lock:
            self._of_source = found
        return found

    def _poll(self, source: NoticeSource) -> None:
        silent, said = 0, ""
        while not self._stopped.is_set():
            try:
                self.ask_once()
                silent, said = 0, ""
            except DrError as error:
                silent += 1
                if silent == SILENT_TIMES and str(error) != said:
                    said = str(error)
                    _logger.info("No notices from %s: %s", source.name, error)
            except Exception as error:  # a fault here must not end the watch
                silent += 1
                if type(error).__name__ != said:
                    said = type(error).__name__
                    _logger.warning("No notices from %s.", source.name, exc_info=error)
            self._stopped.wait(SILENT_POLL_S if silent >= SILENT_TIMES else self._poll_s)

    def _run_command(self) -> None:
        shown = False
        while not self._stopped.is_set():
            code, output = self._run_once(say=not shown)
            if self._stopped.is_set():
                return
            if code == 0:
                notice = notice_of_command(output)
                with self._lock:
                    self._of_command = [Announced(notice, time.monotonic())]
                return
            if not shown and code is not None:
                _logger.info(
                    "%s ended with exit code %d: no notice. It is started again each time.",
                    self._command[0],
                    code,
                )
            shown = True
            self._stopped.wait(self._pause_s)

    def _run_once(self, *, say: bool) -> tuple[int | None, bytes]:
        try:
            with self._lock:
                if self._stopped.is_set():
                    return None, b""
                self._process = process = subprocess.Popen(
                    list(self._command),
                    cwd=self._folder,
                    env=split(os.environ)[0],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    start_new_session=True,
                )
        except (OSError, ValueError) as error:
            if say:
                _logger.warning("DR_INTERRUPTION_COMMAND cannot be started: %s", error)
            return None, b""
        output = b""
        with process:
            assert process.stdout is not None
            while piece := os.read(process.stdout.fileno(), 4096):
                output = (output + piece)[-OUTPUT_BYTES:]
        return process.returncode, output


def command_words(text: str, name: str = "DR_INTERRUPTION_COMMAND") -> list[str]:
    """Program and arguments; no shell reads them.

    Raises:
        SettingsError: A quotation mark is missing.
    """
    try:
        return shlex.split(text)
    except ValueError as error:
        raise SettingsError(
            f"{name}={text} cannot be read: {error}.",
            remedy="Close every quotation mark, as in: sh -c 'wait-for-notice --json'.",
        ) from error


def notice_of_command(output: bytes) -> Notice:
    """The last line of a program's output may be the seconds left."""
    lines = [line.strip() for line in output.decode("utf-8", "replace").splitlines()]
    last = next((line for line in reversed(lines) if line), "")
    left_s: float | None = None
    with suppress(ValueError):
        number = float(last)
        left_s = number if 0.0 <= number < 1e9 else None
    when = "soon" if left_s is None else f"in {left_s:.0f} s"
    text = f"DR_INTERRUPTION_COMMAND says that this machine goes away {when}."
    return Notice("command", "interruption", "terminate", left_s, text)


def _signal_group(process: "subprocess.Popen[bytes]", number: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)


def soonest(announced: Sequence[Announced], now_s: float) -> Announced | None:
    """The first interruption; one without a time comes now."""
    certain = [one for one in announced if one.notice.kind == "interruption"]
    return min(certain, key=lambda one: one.left_s(now_s) or 0.0, default=None)


# Interruption notices of EC2, Google and Azure.


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
    text = str(value or "")
    for read in (datetime.fromisoformat, parsedate_to_datetime):
        try:
            found = read(text)
        except (ValueError, TypeError, IndexError):
            continue
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    return None
