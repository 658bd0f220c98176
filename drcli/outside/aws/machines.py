"""Present and past machines of a stack."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any

from drcli.base.errors import DrError
from drcli.base.report import Col, View, counted, table
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.creation import ADDRESS_USD_PER_HOUR
from drcli.outside.aws.machine_marks import MachineMark
from drcli.outside.aws.prices import LINUX, on_demand_prices
from drcli.outside.aws.stacks import Stack
from drcli.outside.aws.training_template import STACK_TAG

RUNNING = ("pending", "running", "stopping", "shutting-down")


@dataclass(frozen=True)
class Machine:
    """A machine of a stack."""

    instance: Annotated[str, "Its ID at Amazon."]
    type: Annotated[str, "Type of machine."]
    zone: Annotated[str, "Zone of the region."]
    market: Annotated[str, "`spot` or `on-demand`."]
    state: Annotated[str, "Amazon's word; `gone` if Amazon no longer knows it."]
    said: Annotated[str, "Its last state in the bucket, or empty."]
    reason: Annotated[str, "Why, as a sentence, or empty."]
    started: Annotated[float, "Unix seconds; 0 if unknown."]
    ended: Annotated[float, "Unix seconds; 0 while it is there."]
    usd_per_hour: Annotated[float, "The price that it knew; 0 if unknown."] = 0.0

    @property
    def running(self) -> bool:
        """Whether it is there."""
        return self.state in RUNNING

    @property
    def hours(self) -> float:
        """How long it has run; 0 if unknown."""
        end = self.ended or time.time()
        return max(0.0, end - self.started) / 3600 if self.started else 0.0

    def __str__(self) -> str:
        said = f", {self.said}" if self.said else ""
        hours = f", {self.hours:.1f} h" if self.started else ""
        state = f"{self.state}{said}{hours}"
        return f"{self.instance} {self.type} {self.zone} {self.market}: {state}"


def machines_of(account: Account, stack: Stack, marks: Iterable[MachineMark]) -> list[Machine]:
    """All machines of a stack, the oldest first."""
    tag = [{"Name": f"tag:{STACK_TAG}", "Values": [stack.name]}]
    with account.trying(f"look for the machines of {stack.name}"):
        found = account.pages("ec2", "describe_instances", "Reservations", Filters=tag)
    entries = {each["InstanceId"]: each for entry in found for each in entry["Instances"]}
    by_mark = {mark.instance: mark for mark in marks}
    ends = _ends(account, stack)
    machines = [
        _machine(name, entries.get(name), by_mark.get(name), ends)
        for name in {**entries, **by_mark}
        if name in entries or by_mark[name].started >= stack.created - 60
    ]
    return sorted(machines, key=lambda each: (each.started, each.instance))


def scaling_problem(account: Account, stack: Stack) -> str:
    """Why the groups got no machine last time, or empty."""
    for group in stack.groups:
        for entry in _activities(account, group)[:3]:
            if entry.get("StatusCode") in ("Failed", "Cancelled"):
                return " ".join(str(entry.get("StatusMessage", "")).split())
            if entry.get("StatusCode") == "Successful":
                break
    return ""


def _machine(
    name: str,
    entry: Mapping[str, Any] | None,
    mark: MachineMark | None,
    ends: Mapping[str, float],
) -> Machine:
    said, reason, price = (mark.state, mark.text, mark.price) if mark is not None else ("", "", 0.0)
    state, ended = "gone", 0.0
    if entry is not None:
        state, started = entry["State"]["Name"], entry["LaunchTime"].timestamp()
        market = entry.get("InstanceLifecycle", "on-demand")
        type_, zone = entry["InstanceType"], entry["Placement"]["AvailabilityZone"]
    elif mark is not None:
        started, market, type_, zone = mark.started, mark.market, mark.type, mark.zone
    if state not in RUNNING:
        # Amazon writes the moment of an end into a sentence, and forgets a machine after an hour.
        at = _moment(str((entry or {}).get("StateTransitionReason", "")))
        ended = ends.get(name, 0.0) or at or (mark.written if mark is not None else started)
    return Machine(name, type_, zone, market, state, said, reason, started, ended, price)


def _moment(reason: str) -> float:
    """The time in `User initiated (2026-05-01 10:11:12 GMT)`."""
    text = reason.partition("(")[2].partition(" GMT")[0]
    try:
        return datetime.fromisoformat(f"{text}+00:00").timestamp()
    except ValueError:
        return 0.0


def _ends(account: Account, stack: Stack) -> dict[str, float]:
    found: dict[str, float] = {}
    for group in stack.groups:
        for entry in _activities(account, group):
            said = str(entry.get("Description", ""))
            if said.startswith("Terminating EC2 instance: ") and "EndTime" in entry:
                found[said.split(": ")[1].split()[0]] = entry["EndTime"].timestamp()
    return found


def _activities(account: Account, group: str) -> list[dict[str, Any]]:
    try:
        with account.trying(f"read the history of the group {group}"):
            return account.pages(
                "autoscaling",
                "describe_scaling_activities",
                "Activities",
                AutoScalingGroupName=group,
            )
    except DrError:
        return []


# Past cost of a stack's machines.


@dataclass(frozen=True)
class MachineCost:
    """What one machine has cost."""

    instance: Annotated[str, "Its ID at Amazon.", Col("machine")]
    type: Annotated[str, "Type of machine.", Col("type")]
    zone: Annotated[str, "Zone of the region.", Col("zone")]
    market: Annotated[str, "`spot` or `on-demand`.", Col("market")]
    hours: Annotated[float, "How long it has run.", Col("hours", "{:.2f}")]
    usd_per_hour: Annotated[float | None, "Average price; None if unknown.", Col("USD/h", "{:.4f}")]
    usd: Annotated[float | None, "Its cost; None if unknown.", Col("USD", "{:.3f}")]


@dataclass(frozen=True)
class StackCost:
    """What a stack has cost so far."""

    stack: Annotated[str, "Name of the stack."]
    machines: Annotated[list[MachineCost], "The oldest first."]
    extra_usd: Annotated[float, "Addresses; disks and requests cost less and are left out."]
    notes: Annotated[list[str], "What is not known, as sentences."]

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

    def view(self) -> View:
        least = "" if self.complete else "at least "
        machines = counted(len(self.machines), "machine")
        return [
            table(self.machines),
            self.machines and f"Addresses: {self.extra_usd:.3f} USD.",
            f"{self.stack}: {least}{self.usd:.2f} USD for {self.hours:.1f} h of {machines}.",
        ]


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
