"""Shows stacks, machines, prices and costs of `dr-spot`."""

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows, counted, indented

if TYPE_CHECKING:
    from drcli.outside.aws.creation import CreatedStack, StackPlan
    from drcli.outside.aws.machines import StackCost
    from drcli.outside.aws.prices import Offers
    from drcli.outside.aws.stack_end import BucketContent, StoppedStack
    from drcli.outside.aws.stack_report import StackReport, StackReports


@dataclass(frozen=True)
class Planned:
    """A plan for programs.

    Attributes:
        stack: Name of the stack.
        region: AWS region.
        bucket: Name of the bucket.
        model: Prefix of the model in the bucket.
        resumes: The checkpoint from which the training continues; empty for a new model.
        types: Types that may be used.
        zones: Zones that may be used.
        market: `spot`, `on-demand` or `spot-or-on-demand`.
        ttl_minutes: Time after which the machines end; 0 for never.
        least_usd_per_hour: Price of the cheapest machine now; None if unknown.
        most_usd_per_hour: Price of the dearest machine that may be used; None if unknown.
        extra_usd_per_hour: Price of disk and address.
        most_usd: Highest cost until the end; None if unknown or without a time limit.
        installs: What the machine installs.
        files: Names of the files that the machine gets.
    """

    stack: str
    region: str
    bucket: str
    model: str
    resumes: str
    types: tuple[str, ...]
    zones: tuple[str, ...]
    market: str
    ttl_minutes: int
    least_usd_per_hour: float | None
    most_usd_per_hour: float | None
    extra_usd_per_hour: float
    most_usd: float | None
    installs: str
    files: tuple[str, ...]

    @staticmethod
    def of(plan: "StackPlan", region: str) -> "Planned":
        """The plan."""
        wishes, money = plan.wishes, plan.estimate
        return Planned(
            wishes.stack,
            region,
            wishes.bucket,
            plan.settings.model_prefix,
            plan.resumes,
            tuple(each.name for each in plan.types),
            plan.zones,
            wishes.market,
            wishes.ttl_minutes,
            money.least,
            money.most,
            money.extra,
            money.total,
            plan.source.shown,
            tuple(sorted(plan.files)),
        )


def plan(planned: "StackPlan", region: str) -> RenderableType:
    return Text(plan_text(planned, region))


def plan_text(planned: "StackPlan", region: str) -> str:
    wishes, money = planned.wishes, planned.estimate
    model = f"s3://{wishes.bucket}/{planned.settings.model_prefix}"
    kind = {
        "spot": "a spot machine",
        "spot-or-on-demand": "a spot machine, or an ordinary one while there is none",
        "on-demand": "an ordinary machine",
    }[wishes.market]
    goes_on = f", from {planned.resumes}" if planned.resumes else ""
    names = ", ".join(each.name for each in planned.types)
    lines = [
        f"{wishes.stack}: trains {model}{goes_on} on {kind} in {region}.",
        f"Types: {names}; zones: {', '.join(planned.zones)}; installs {planned.source.shown}.",
    ]
    if money.least is None or money.most is None:
        lines.append("What it costs is not known.")
    else:
        hourly = f"{money.least:.3f}"
        if money.most - money.least >= 0.0005:
            hourly += f" to {money.most:.3f}"
        lines.append(f"Price now: {hourly} USD per hour, and {money.extra:.3f} for the rest.")
    if money.hours is None:
        lines.append("It runs, and costs money, until the training ends: there is no time limit.")
    elif money.total is not None:
        lines.append(f"At most {money.total:.2f} USD in {money.hours:g} h, at these prices.")
    return "\n".join(lines)


def created(report: "CreatedStack") -> RenderableType:
    until = f" It ends at {_clock(report.ends)} at the latest." if report.ends else ""
    return Text(
        f"Started {report.stack} in {report.region}: trains s3://{report.bucket}/{report.model}."
        f"{until}"
    )


def base(stack: str, region: str, bucket: str) -> RenderableType:
    return Text(f"Made {stack} in {region}: bucket {bucket}.")


def stacks(found: "StackReports") -> RenderableType:
    if not found.stacks:
        return Text(f"There are no stacks in {found.region}.")
    parts: list[RenderableType] = []
    for each in found.stacks:
        parts.append(Text(_headline(each)))
        if each.reason:
            parts.append(indented(each.reason))
        for machine in each.machines:
            hours = f", {machine.hours:.1f} h" if machine.started else ""
            said = f", {machine.said}" if machine.said else ""
            parts.append(
                indented(
                    f"{machine.instance} {machine.type} {machine.zone} {machine.market}: "
                    f"{machine.state}{said}{hours}"
                )
            )
    return Group(*parts)


def _headline(each: "StackReport") -> str:
    if each.kind == "base":
        return f"{each.stack}: base, {each.state}, bucket {each.bucket}"
    newest = f", {each.checkpoint}" if each.checkpoint else ""
    money = f", {each.usd:.2f} USD" if each.usd is not None else ""
    until = f", until {_clock(each.ends)}" if each.ends else ""
    return f"{each.stack}: {each.state}, s3://{each.bucket}/{each.model}{newest}{money}{until}"


def offers(found: "Offers") -> RenderableType:
    if not found.offers:
        return Text("There are no such machines.")
    return Rows(
        ("type", "zone", "USD/h", "workers", "USD/h per worker", "interrupted"),
        [
            (
                each.type,
                each.zone,
                f"{each.usd_per_hour:.4f}",
                str(each.workers),
                f"{each.usd_per_worker_hour:.4f}",
                each.interruptions or "-",
            )
            for each in found.offers
        ],
        left=("type", "zone"),
    )


def cost(report: "StackCost") -> RenderableType:
    least = "" if report.complete else "at least "
    total = Text(
        f"{report.stack}: {least}{report.usd:.2f} USD for {report.hours:.1f} h of "
        f"{counted(len(report.machines), 'machine')}."
    )
    if not report.machines:
        return total
    rows = [
        (
            each.instance,
            each.type,
            each.zone,
            each.market,
            f"{each.hours:.2f}",
            "-" if each.usd_per_hour is None else f"{each.usd_per_hour:.4f}",
            "-" if each.usd is None else f"{each.usd:.3f}",
        )
        for each in report.machines
    ]
    rows.append(("addresses", "", "", "", "", "", f"{report.extra_usd:.3f}"))
    names = ("machine", "type", "zone", "market", "hours", "USD/h", "USD")
    return Group(Rows(names, rows, left=("machine", "type", "zone", "market")), total)


def stopped(report: "StoppedStack") -> RenderableType:
    if not report.checkpoint:
        return Text(f"Removed {report.stack}. There is no checkpoint of {report.model}.")
    state = "is whole" if report.whole else "was not checked"
    return Text(
        f"Removed {report.stack}. The model {report.model} stays in the bucket. Its newest "
        f"checkpoint, {report.checkpoint}, {state}."
    )


def content(found: "BucketContent") -> str:
    models = f", among them the models {', '.join(found.models)}" if found.models else ""
    return (
        f"The bucket {found.bucket} holds {counted(found.objects, 'object')} with "
        f"{found.size_bytes / 1e6:,.1f} MB{models}."
    )


def base_deleted(stack: str, objects: int, *, kept: bool) -> RenderableType:
    rest = "; its bucket stays" if kept else f" with {counted(objects, 'object')} in its bucket"
    return Text(f"Removed {stack}{rest}.")


def _clock(at: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(at))
