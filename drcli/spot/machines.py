"""Present and past machines of a stack."""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from drcli.base.errors import DrError
from drcli.spot.aws_account import Account
from drcli.spot.machine_marks import ENDED, MachineMark
from drcli.spot.stacks import Stack
from drcli.spot.training_template import STACK_TAG

RUNNING = ("pending", "running", "stopping", "shutting-down")


@dataclass(frozen=True)
class Machine:
    """A machine of a stack.

    Attributes:
        instance: Its ID at Amazon.
        type: Type of machine.
        zone: Zone of the region.
        market: `spot` or `on-demand`.
        state: Amazon's word; `gone` if Amazon no longer knows it.
        said: Its last state in the bucket, or empty.
        reason: Why, as a sentence, or empty.
        started: Unix seconds; 0 if unknown.
        ended: Unix seconds; 0 while it is there.
        usd_per_hour: The price that it knew; 0 if unknown.
    """

    instance: str
    type: str
    zone: str
    market: str
    state: str
    said: str
    reason: str
    started: float
    ended: float
    usd_per_hour: float = 0.0

    @property
    def running(self) -> bool:
        """Whether it is there."""
        return self.state in RUNNING

    @property
    def hours(self) -> float:
        """How long it has run; 0 if unknown."""
        end = self.ended or time.time()
        return max(0.0, end - self.started) / 3600 if self.started else 0.0


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
    state = entry["State"]["Name"] if entry is not None else "gone"
    said, reason = (mark.state, mark.text) if mark is not None else ("", "")
    started = entry["LaunchTime"].timestamp() if entry is not None else 0.0
    if not started and mark is not None:
        started = mark.started
    ended = 0.0
    if state not in RUNNING:
        # Amazon writes the moment of an end into a sentence, and forgets a machine after an hour.
        last = mark.written if mark is not None and mark.state in ENDED else 0.0
        at = _moment(str((entry or {}).get("StateTransitionReason", "")))
        ended = ends.get(name, 0.0) or at or last or (mark.written if mark is not None else started)
    if entry is not None:
        market = entry.get("InstanceLifecycle", "on-demand")
        type_, zone = entry["InstanceType"], entry["Placement"]["AvailabilityZone"]
    else:
        market = mark.market if mark is not None else "on-demand"
        type_, zone = (mark.type, mark.zone) if mark is not None else ("", "")
    price = mark.price if mark is not None else 0.0
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
