"""Prices of spot and ordinary machines."""

import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Literal

from drcli.spot.aws_account import Account
from drcli.spot.instance_types import InstanceType
from drcli.spot.spot_advisor import CLASSES, Advisor

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
    """Machines of one type in one zone.

    Attributes:
        type: Type of machine.
        region: AWS region.
        zone: Zone of the region.
        usd_per_hour: Spot price now.
        workers: Simulation workers that it has processor threads for.
        interruptions: One of the advisor's classes, or empty.
    """

    type: str
    region: str
    zone: str
    usd_per_hour: float
    workers: int
    interruptions: str = ""

    @property
    def usd_per_worker_hour(self) -> float:
        """The price divided by the number of workers."""
        return self.usd_per_hour / self.workers


@dataclass(frozen=True)
class Offers:
    """All that were found.

    Attributes:
        offers: In the wanted order.
        missing: What is unknown, as sentences.
    """

    offers: list[Offer]
    missing: list[str]


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
            name, account.region, zone, usd, workers[name], advisor.frequency(account.region, name)
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
