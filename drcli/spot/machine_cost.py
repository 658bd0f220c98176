"""Past cost of a stack's machines."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from drcli.base.errors import DrError
from drcli.spot.aws_account import Account
from drcli.spot.cost_estimate import ADDRESS_USD_PER_HOUR
from drcli.spot.machines import Machine
from drcli.spot.prices import LINUX, on_demand_prices


@dataclass(frozen=True)
class MachineCost:
    """What one machine has cost.

    Attributes:
        instance: Its ID at Amazon.
        type: Type of machine.
        zone: Zone of the region.
        market: `spot` or `on-demand`.
        hours: How long it has run.
        usd_per_hour: Average price; None if unknown.
        usd: Its cost; None if unknown.
    """

    instance: str
    type: str
    zone: str
    market: str
    hours: float
    usd_per_hour: float | None
    usd: float | None


@dataclass(frozen=True)
class StackCost:
    """What a stack has cost so far.

    Attributes:
        stack: Name of the stack.
        machines: The oldest first.
        extra_usd: Addresses; disks and requests cost less and are left out.
        notes: What is not known, as sentences.
    """

    stack: str
    machines: list[MachineCost]
    extra_usd: float
    notes: list[str]

    @property
    def hours(self) -> float:
        """Hours of all machines together."""
        return sum(each.hours for each in self.machines)

    @property
    def complete(self) -> bool:
        """Whether the price of every machine is known."""
        return all(each.usd is not None for each in self.machines)

    @property
    def usd(self) -> float:
        """Cost of all machines whose price is known, and of the addresses."""
        return sum(each.usd or 0.0 for each in self.machines) + self.extra_usd


def cost_of(account: Account, stack: str, machines: Sequence[Machine]) -> StackCost:
    notes: list[str] = []
    costs = [_one(account, machine, notes) for machine in machines]
    unknown = [each.instance for each in costs if each.usd is None]
    if unknown:
        notes.append(f"The price of {', '.join(unknown)} is not known.")
    extra = sum(each.hours for each in costs) * ADDRESS_USD_PER_HOUR
    return StackCost(stack, costs, extra, list(dict.fromkeys(notes)))


def _one(account: Account, machine: Machine, notes: list[str]) -> MachineCost:
    lasted, usd = machine.hours, None
    if machine.market == "spot" and machine.started:
        try:
            usd = spot_usd(account, machine)
        except DrError as error:
            notes.append(f"{error} The price at the start of each machine is used.")
    if usd is None and machine.usd_per_hour:
        usd = machine.usd_per_hour * lasted
    if usd is None and machine.market != "spot" and machine.type:
        try:
            known = on_demand_prices(account, [machine.type])
        except DrError as error:
            notes.append(str(error))
        else:
            usd = known[machine.type] * lasted if machine.type in known else None
    return MachineCost(
        machine.instance,
        machine.type,
        machine.zone,
        machine.market,
        lasted,
        usd / lasted if usd is not None and lasted else None,
        usd,
    )


def spot_usd(account: Account, machine: Machine) -> float | None:
    """Cost by price history; None without one."""
    start = datetime.fromtimestamp(machine.started, UTC)
    end = datetime.fromtimestamp(machine.ended, UTC) if machine.ended else datetime.now(UTC)
    with account.trying("read the history of spot prices"):
        found = account.pages(
            "ec2",
            "describe_spot_price_history",
            "SpotPriceHistory",
            InstanceTypes=[machine.type],
            ProductDescriptions=[LINUX],
            AvailabilityZone=machine.zone,
            StartTime=start,
            EndTime=end,
        )
    own = [entry for entry in found if entry["AvailabilityZone"] == machine.zone]
    return at_prices(own, start, end)


def at_prices(history: Sequence[Any], start: datetime, end: datetime) -> float | None:
    """USD. A price counts until the next; the first also before."""
    entries = sorted(history, key=lambda entry: entry["Timestamp"])
    if not entries:
        return None
    moments = [max(start, min(end, entry["Timestamp"])) for entry in entries]
    moments[0] = start
    usd = 0.0
    for entry, since, until in zip(entries, moments, [*moments[1:], end], strict=True):
        usd += float(entry["SpotPrice"]) * max(0.0, (until - since).total_seconds()) / 3600
    return usd
