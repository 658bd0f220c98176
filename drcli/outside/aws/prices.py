"""Prices of spot and ordinary machines."""

import json
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from drcli.base.errors import DrError, StorageError
from drcli.base.installation import lazy_imports
from drcli.base.json_record import RecordError, decode_json
from drcli.base.report import Col, View, table
from drcli.clouds.providers.amazon import ec2_metadata
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.instance_types import InstanceType

with lazy_imports():
    import requests
    from botocore import exceptions as boto

# Interruption rates from Amazon's public Spot Advisor.


ADDRESS = "https://spot-bid-advisor.s3.amazonaws.com/spot-advisor-data.json"
ADDRESS_VARIABLE = "DRCLI_SPOT_ADVISOR_URL"

CLASSES = ("<5%", "5-10%", "10-15%", "15-20%", ">20%")
"""Machines interrupted within a month."""

_TIMEOUT_S = 15.0
_MOST_BYTES = 50_000_000


Advisor = dict[tuple[str, str], str]
"""One of `CLASSES` by region and type."""


def read_advisor() -> Advisor:
    """Read the public file, or the environment's.

    Raises:
        StorageError: It cannot be read.
    """
    address = os.environ.get(ADDRESS_VARIABLE) or ADDRESS
    try:
        with requests.get(address, timeout=_TIMEOUT_S, stream=True) as answer:
            answer.raise_for_status()
            data = answer.raw.read(_MOST_BYTES, decode_content=True)
        return advisor_of(decode_json(dict[str, Any], data))
    except (requests.RequestException, RecordError, OSError, ValueError) as error:
        raise StorageError(
            f"How often machines are interrupted is not known: {address} cannot be read "
            f"({type(error).__name__}).",
            remedy=f"Check the network, or set {ADDRESS_VARIABLE} to a copy of that file.",
        ) from error


def advisor_of(content: Any) -> Advisor:
    """Leaves out entries of unknown form."""
    found: Advisor = {}
    regions = content.get("spot_advisor") if isinstance(content, dict) else None
    for region, systems in _entries(regions):
        for name, facts in _entries(systems.get("Linux") if isinstance(systems, dict) else None):
            number = facts.get("r") if isinstance(facts, dict) else None
            if type(number) is int and 0 <= number < len(CLASSES):
                found[region, name] = CLASSES[number]
    if not found:
        raise RecordError("it names no region with machines")
    return found


def _entries(value: Any) -> list[tuple[str, Any]]:
    return list(value.items()) if isinstance(value, dict) else []


PRICING_REGION = "us-east-1"
"""One of few that know on-demand prices."""

LINUX = "Linux/UNIX"
SortKey = Literal[
    "SpotPrice",
    "PricePerWorkerHour",
    "NumberOfWorkers",
    "InterruptionFrequency",
    "Region",
    "InstanceType",
]

_USD = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True)
class Offer:
    """Machines of one type in one zone."""

    type: Annotated[str, "Type of machine.", Col("type")]
    region: Annotated[str, "AWS region."]
    zone: Annotated[str, "Zone of the region.", Col("zone")]
    usd_per_hour: Annotated[float, "Spot price now.", Col("USD/h", "{:.4f}")]
    workers: Annotated[int, "Simulation workers that it has processor threads for.", Col("workers")]
    interruptions: Annotated[
        str,
        "One of the advisor's classes, or empty.",
        Col("interrupted", lambda text: text or "-", side="right"),
    ] = ""

    @property
    def usd_per_worker_hour(self) -> float:
        """The price divided by the number of workers."""
        return self.usd_per_hour / self.workers


@dataclass(frozen=True)
class Offers:
    """All that were found."""

    offers: Annotated[list[Offer], "In the wanted order."]
    missing: Annotated[list[str], "What is unknown, as sentences."]

    def view(self) -> View:
        if not self.offers:
            return ["There are no such machines."]
        each_worker = Col("USD/h per worker", "{:.4f}", of=lambda each: each.usd_per_worker_hour)
        order = ("type", "zone", "usd_per_hour", "workers", each_worker, "interruptions")
        return [table(self.offers, *order)]


def current_prices(account: Account, names: Sequence[str]) -> dict[tuple[str, str], float]:
    """USD per hour, by type and zone."""
    with account.trying(f"read the spot prices in {account.region}"):
        found = account.pages(
            "ec2",
            "describe_spot_price_history",
            "SpotPriceHistory",
            InstanceTypes=list(names),
            ProductDescriptions=[LINUX],
            StartTime=datetime.now(UTC),
        )
    newest: dict[tuple[str, str], tuple[Any, float]] = {}
    for entry in found:
        place = (entry["InstanceType"], entry["AvailabilityZone"])
        seen = newest.get(place)
        if seen is None or entry["Timestamp"] >= seen[0]:
            newest[place] = entry["Timestamp"], float(entry["SpotPrice"])
    return {place: price for place, (_, price) in newest.items()}


def offers_of(account: Account, types: Sequence[InstanceType], advisor: Advisor) -> list[Offer]:
    workers = {each.name: each.workers for each in types}
    prices = current_prices(account, list(workers))
    return [
        Offer(
            name, account.region, zone, usd, workers[name], advisor.get((account.region, name), "")
        )
        for (name, zone), usd in prices.items()
        if name in workers
    ]


def arranged(
    offers: Iterable[Offer], order: SortKey, allowed: Collection[str] | None
) -> list[Offer]:
    kept = [each for each in offers if allowed is None or each.interruptions in allowed]
    unknown = len(CLASSES)
    ranks = {name: rank for rank, name in enumerate(CLASSES)}

    def place(each: Offer) -> tuple[Any, ...]:
        own: Mapping[SortKey, Any] = {
            "SpotPrice": each.usd_per_hour,
            "PricePerWorkerHour": each.usd_per_worker_hour,
            "NumberOfWorkers": each.workers,
            "InterruptionFrequency": ranks.get(each.interruptions, unknown),
            "Region": each.region,
            "InstanceType": each.type,
        }
        return own[order], each.usd_per_worker_hour, each.type, each.zone

    return sorted(kept, key=place)


def on_demand_prices(account: Account, names: Iterable[str]) -> dict[str, float]:
    """USD per hour where known."""
    found: dict[str, float] = {}
    with account.trying("read the prices of ordinary machines"):
        pricing = account.client("pricing", PRICING_REGION)
        for name in names:
            wanted = {
                "instanceType": name,
                "regionCode": account.region,
                "operatingSystem": "Linux",
                "tenancy": "Shared",
                "preInstalledSw": "NA",
                "capacitystatus": "Used",
            }
            filters = [
                {"Type": "TERM_MATCH", "Field": field, "Value": value}
                for field, value in wanted.items()
            ]
            answer = pricing.get_products(ServiceCode="AmazonEC2", Filters=filters, MaxResults=10)
            for text in answer["PriceList"]:
                if (price := _hourly(text)) is not None:
                    found[name] = price
    return found


def _hourly(text: str) -> float | None:
    with suppress(ValueError, KeyError, AttributeError):
        for term in json.loads(text)["terms"]["OnDemand"].values():
            for dimension in term["priceDimensions"].values():
                price = dimension["pricePerUnit"]["USD"]
                if dimension["unit"] == "Hrs" and _USD.fullmatch(price) and float(price) > 0:
                    return float(price)
    return None


# Price of the spot instance that runs this.


_EC2_TIMEOUT_S = 10.0
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

    try:
        account = Account(region, profile, attempts=2, timeout_s=_EC2_TIMEOUT_S)
        answer = account.client("ec2").describe_spot_price_history(
            InstanceTypes=[kind],
            AvailabilityZone=zone,
            ProductDescriptions=[LINUX],
            StartTime=datetime.now(UTC),
            MaxResults=1,
        )
        prices = [float(entry["SpotPrice"]) for entry in answer["SpotPriceHistory"]]
    except (boto.BotoCoreError, boto.ClientError, KeyError, ValueError) as error:
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


def _unknown(why: str) -> StorageError:
    return StorageError(
        f"DR_SPOT_PRICE=auto: {why}.",
        remedy="Write the price in USD per hour, as in DR_SPOT_PRICE=0.25.",
    )
