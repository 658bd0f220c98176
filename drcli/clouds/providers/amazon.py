"""Amazon EC2: spot instances, Auto Scaling groups, recommendations to move."""

import math
import time
from collections.abc import Callable, Mapping

from drcli.clouds.cloud import (
    LEAVING_S,
    Cloud,
    MetadataResponse,
    MetadataService,
    Notice,
    moment,
    silent,
)

EC2_IPV4, EC2_IPV6 = "http://169.254.169.254", "http://[fd00:ec2::254]"

TOKEN_S = 21_600
"""The longest life of an EC2 token."""

TOKEN_RENEW_S = 0.5 * TOKEN_S

EC2_NOTICE_S = 120.0
"""Source: EC2 user guide."""

HIBERNATE_S = 10.0
"""The notice comes when hibernation begins."""


class Ec2Metadata:
    """Reads with IMDSv2."""

    def __init__(self, service: MetadataService) -> None:
        self._service = service
        self._token = ""
        self._token_s = -math.inf

    def read(self, path: str) -> MetadataResponse | None:
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

    def _with_token(self, path: str) -> MetadataResponse:
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


class Ec2Notices:
    name = "Amazon EC2"

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

    def is_spot(self) -> bool:
        found = self._metadata.read("instance-life-cycle")
        return found is not None and found.text == "spot"

    def _interruption(self, answer: MetadataResponse) -> Notice:
        values = answer.object()
        action = str(values.get("action") or "terminate")
        left_s = HIBERNATE_S if action == "hibernate" else EC2_NOTICE_S
        when = moment(values.get("time"))
        if when is not None:
            left_s = min(left_s, max(0.0, when - answer.now(self._clock())))
        text = f"EC2 announces that it will {action} this instance in {left_s:.0f} s."
        return Notice("aws", "interruption", action, left_s, text)


def _source(environment: Mapping[str, str], address: str) -> Ec2Notices | None:
    metadata = ec2_metadata(environment, address)
    return None if metadata is None else Ec2Notices(metadata)


CLOUD = Cloud(
    "aws",
    Ec2Notices.name,
    "AWS_EC2_METADATA_SERVICE_ENDPOINT",
    lambda dmi: dmi["sys_vendor"] == "Amazon EC2" or dmi["bios_version"].endswith(".amazon"),
    _source,
)
