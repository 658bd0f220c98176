"""Price of the spot instance that runs this."""

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from drcli.base.errors import DrError, StorageError
from drcli.config import secret_environment
from drcli.spot.aws_account import PROFILE_SETTING
from drcli.spot.metadata_service import ec2_metadata
from drcli.spot.prices import LINUX
from drcli.store.profiles import session_of

_TIMEOUT_S = 10.0
"""The count of machine hours waits for the answer."""


@dataclass(frozen=True)
class SpotPrice:
    usd_per_hour: float
    place: str


def own_spot_price(profile: str | None = None) -> SpotPrice:
    """Needs ec2:DescribeSpotPriceHistory.

    Raises:
        StorageError: This is not a spot instance, or EC2 does not tell.
    """
    kind, zone, region = _instance()
    place = f"{kind} in {zone}"
    from botocore.exceptions import BotoCoreError, ClientError

    try:
        answer = _client(region, profile).describe_spot_price_history(
            InstanceTypes=[kind],
            AvailabilityZone=zone,
            ProductDescriptions=[LINUX],
            StartTime=datetime.now(UTC),
            MaxResults=1,
        )
        prices = [float(entry["SpotPrice"]) for entry in answer["SpotPriceHistory"]]
    except (BotoCoreError, ClientError, KeyError, ValueError) as error:
        raise _unknown(f"EC2 does not tell the spot price of {place}: {error}") from error
    if not prices:
        raise _unknown(f"EC2 knows no spot price of {place}")
    return SpotPrice(prices[0], place)


def _instance() -> tuple[str, str, str]:
    names = (
        "instance-type",
        "placement/availability-zone",
        "placement/region",
        "instance-life-cycle",
    )
    try:
        metadata = ec2_metadata(os.environ)
        answers = [] if metadata is None else [metadata.read(name) for name in names]
    except DrError as error:  # it does not answer, or its address is wrong
        raise _unknown("this machine has no metadata service of EC2") from error
    if metadata is None:
        raise _unknown("AWS_EC2_METADATA_DISABLED forbids asking the metadata service")
    texts = [answer.text for answer in answers if answer is not None]
    if len(texts) < len(names):
        raise _unknown("this machine has no metadata service of EC2")
    kind, zone, region, market = texts
    if market != "spot":
        raise _unknown(f"this {kind} is no spot instance")
    return kind, zone, region


def _client(region: str, profile: str | None) -> Any:
    from botocore.config import Config

    config = Config(
        retries={"total_max_attempts": 2, "mode": "standard"},
        connect_timeout=_TIMEOUT_S,
        read_timeout=_TIMEOUT_S,
    )
    with secret_environment.lent():
        return session_of(profile, PROFILE_SETTING).client("ec2", region_name=region, config=config)


def _unknown(why: str) -> StorageError:
    return StorageError(
        f"DR_SPOT_PRICE=auto: {why}.",
        remedy="Write the price in USD per hour, as in DR_SPOT_PRICE=0.25.",
    )
