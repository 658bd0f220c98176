"""Asks EC2 what the spot instance costs on which this program runs."""

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from drcli.base.errors import StorageError
from drcli.config import secret_environment
from drcli.store.profiles import session_of

ADDRESS = "http://169.254.169.254"
ADDRESS_VARIABLE = "AWS_EC2_METADATA_SERVICE_ENDPOINT"

_TIMEOUT_S = 2.0
_READ_TIMEOUT_S = 10.0
_SYSTEM = "Linux/UNIX"


@dataclass(frozen=True)
class SpotPrice:
    """A price in USD per hour, and what it is the price of."""

    usd_per_hour: float
    place: str


def own_spot_price(profile: str | None = None) -> SpotPrice:
    """The present spot price of this instance. Its keys need ec2:DescribeSpotPriceHistory.

    Raises:
        StorageError: This is no spot instance of EC2, or EC2 does not tell its price.
    """
    kind, zone, region = _instance()
    place = f"{kind} in {zone}"
    from botocore.exceptions import BotoCoreError, ClientError

    try:
        answer = _client(region, profile).describe_spot_price_history(
            InstanceTypes=[kind],
            AvailabilityZone=zone,
            ProductDescriptions=[_SYSTEM],
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
    """Type, zone and region of this spot instance, from its metadata service."""
    import requests

    if os.environ.get("AWS_EC2_METADATA_DISABLED", "").casefold() == "true":
        raise _unknown("AWS_EC2_METADATA_DISABLED forbids to ask the metadata service")
    address = (os.environ.get(ADDRESS_VARIABLE) or ADDRESS).rstrip("/")
    with requests.Session() as session:
        session.trust_env = False  # no proxy: the service is in the machine
        try:
            answer = session.put(
                f"{address}/latest/api/token",
                headers={"X-aws-ec2-metadata-token-ttl-seconds": "60"},
                timeout=_TIMEOUT_S,
                allow_redirects=False,
            )
            answer.raise_for_status()
            token = {"X-aws-ec2-metadata-token": answer.text}

            def read(name: str) -> str:
                found = session.get(
                    f"{address}/latest/meta-data/{name}",
                    headers=token,
                    timeout=_TIMEOUT_S,
                    allow_redirects=False,
                )
                found.raise_for_status()
                return found.text.strip()

            kind, zone = read("instance-type"), read("placement/availability-zone")
            region = read("placement/region")
            if read("instance-life-cycle") != "spot":
                raise _unknown(f"this {kind} is no spot instance")
        except (requests.RequestException, ValueError) as error:
            raise _unknown("this machine has no metadata service of EC2") from error
    return kind, zone, region


def _client(region: str, profile: str | None) -> Any:
    from botocore.config import Config

    config = Config(
        retries={"total_max_attempts": 2, "mode": "standard"},
        connect_timeout=_READ_TIMEOUT_S,
        read_timeout=_READ_TIMEOUT_S,
    )
    with secret_environment.lent():
        return session_of(profile, "DR_LOCAL_S3_PROFILE").client(
            "ec2", region_name=region, config=config
        )


def _unknown(why: str) -> StorageError:
    return StorageError(
        f"DR_SPOT_PRICE=auto: {why}.",
        remedy="Write the price in USD per hour, as in DR_SPOT_PRICE=0.25.",
    )
