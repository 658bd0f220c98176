"""Cost of machines before there are any."""

from collections.abc import Sequence
from dataclasses import dataclass

from drcli.base.errors import DrError, StorageError
from drcli.spot.aws_account import Account
from drcli.spot.before_spending import Wishes
from drcli.spot.instance_types import InstanceType
from drcli.spot.prices import current_prices, on_demand_prices

DISK_USD_PER_GB_HOUR = 0.08 / 730
ADDRESS_USD_PER_HOUR = 0.005
"""gp3 disk and public IPv4 address in Virginia, 2026."""


@dataclass(frozen=True)
class Estimate:
    """USD per hour.

    Attributes:
        least: Cheapest machine now; None if unknown.
        most: Dearest machine that may be used.
        extra: Disk and address.
        hours: Longest life; None for ever.
    """

    least: float | None
    most: float | None
    extra: float
    hours: float | None

    @property
    def total(self) -> float | None:
        if self.most is None or self.hours is None:
            return None
        return (self.most + self.extra) * self.hours


def known_prices(
    account: Account, types: Sequence[InstanceType], market: str
) -> tuple[list[float], dict[str, float], list[str]]:
    """Hourly prices that may be paid, on-demand prices, and notes."""
    names, notes = [each.name for each in types], []
    spot: list[float] = []
    ordinary: dict[str, float] = {}
    if market != "on-demand":
        try:
            spot = list(current_prices(account, names).values())
        except DrError as error:
            notes.append(f"{error} The estimate is incomplete.")
    if market != "spot":
        try:
            ordinary = on_demand_prices(account, names)
        except DrError as error:
            notes.append(f"{error} The estimate is incomplete.")
    return [*spot, *ordinary.values()], ordinary, notes


def estimate(prices: list[float], wishes: Wishes) -> Estimate:
    """Raises StorageError if no machine is as cheap as wanted."""
    cap = wishes.most_usd
    if cap is not None and wishes.market == "spot":
        prices = [price for price in prices if price <= cap]
        if not prices:
            raise StorageError(
                f"No spot machine costs at most {cap} USD per hour now.",
                remedy="Raise --max-price, or allow other types; `dr-spot prices` shows them.",
            )
    return Estimate(
        min(prices, default=None),
        max(prices, default=None),
        wishes.disk_gb * DISK_USD_PER_GB_HOUR + ADDRESS_USD_PER_HOUR,
        wishes.ttl_minutes / 60 if wishes.ttl_minutes else None,
    )
