"""What `dr-spot list` says about stacks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

from drcli.base.errors import DrError
from drcli.base.report import View, minute
from drcli.model import keys, lease
from drcli.model.model_prefix import newest_checkpoint
from drcli.model.model_store import ModelStore
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.machine_marks import read_marks
from drcli.outside.aws.machines import Machine, cost_of, machines_of, scaling_problem
from drcli.outside.aws.stacks import Stack

SILENT_S = 600.0
"""A machine tells the bucket of its boot within a minute."""


@dataclass(frozen=True)
class StackReport:
    """A stack, its machines and its training."""

    stack: Annotated[str, "Name of the stack."]
    kind: Annotated[str, "`training` or `base`."]
    status: Annotated[str, "CloudFormation's word."]
    state: Annotated[str, "In a word: `training`, `booting`, `failed`, ..."]
    reason: Annotated[str, "Why, as a sentence, or empty."]
    model: Annotated[str, "Prefix in the bucket."]
    bucket: Annotated[str, "Name of the bucket."]
    checkpoint: Annotated[str, "Newest one, or empty."]
    machines: Annotated[tuple[Machine, ...], "The oldest first."]
    usd: Annotated[float | None, "Cost so far; None if unknown or not asked for."]
    created: Annotated[float, "When the stack was made, in Unix seconds."]
    ends: Annotated[float, "When the machines end, in Unix seconds; 0 for never."]

    def __str__(self) -> str:
        if self.kind == "base":
            return f"{self.stack}: base, {self.state}, bucket {self.bucket}"
        newest = f", {self.checkpoint}" if self.checkpoint else ""
        money = f", {self.usd:.2f} USD" if self.usd is not None else ""
        until = f", until {minute(self.ends)}" if self.ends else ""
        return f"{self.stack}: {self.state}, s3://{self.bucket}/{self.model}{newest}{money}{until}"


@dataclass(frozen=True)
class StackReports:
    """All stacks of a region."""

    region: Annotated[str, "AWS region."]
    stacks: Annotated[list[StackReport], "By name."]

    def view(self) -> View:
        for each in self.stacks:
            yield str(each)
            yield [each.reason, *map(str, each.machines)]
        yield not self.stacks and f"There are no stacks in {self.region}."


def report_on(account: Account, stack: Stack, *, with_cost: bool = True) -> StackReport:
    blank = StackReport(
        stack.name,
        stack.kind,
        stack.status,
        stack.status.lower().replace("_", " "),
        "",
        stack.model,
        stack.bucket,
        "",
        (),
        None,
        stack.created,
        stack.ends,
    )
    if stack.kind != "training":
        return replace(blank, state="ready" if stack.status.endswith("_COMPLETE") else blank.state)
    bucket = account.bucket(stack.bucket)
    try:
        marks = read_marks(bucket, stack.name)
        model = ModelStore(bucket, stack.model)
        newest = newest_checkpoint(model) if keys.is_valid_prefix(model.prefix) else None
        checkpoint, owned = str(newest or ""), lease.holder(model) is not None
    except DrError as error:
        marks, checkpoint, owned = [], "", False
        blank = replace(blank, reason=str(error))
    machines = machines_of(account, stack, marks)
    known = cost_of(account, stack.name, machines) if with_cost and machines else None
    report = replace(
        blank,
        checkpoint=checkpoint,
        machines=tuple(machines),
        usd=known.usd if known is not None and known.complete else None,
    )
    if stack.status != "CREATE_COMPLETE":
        return report
    state, reason = _state(machines, stack.name, owned=owned)
    if state == "waiting for a machine":
        reason = scaling_problem(account, stack)
    return replace(report, state=state, reason=reason or report.reason)


def _state(machines: Sequence[Machine], stack: str, *, owned: bool) -> tuple[str, str]:
    there = [each for each in machines if each.running]
    if there:
        last = there[-1]
        if last.said in ("training", "waiting", "restarting"):
            return ("training" if owned else last.said), last.reason
        return last.said or "booting", last.reason or _silence(last, stack)
    if machines and machines[-1].said in ("finished", "stopped", "failed"):
        return machines[-1].said, machines[-1].reason
    return "waiting for a machine", ""


def _silence(machine: Machine, stack: str) -> str:
    silent_s = 3600 * machine.hours
    if machine.said or silent_s < SILENT_S:
        return ""
    return (
        f"{machine.instance} has not reached the bucket in {silent_s / 60:.0f} minutes; "
        f"`dr-spot logs {stack} console` in a terminal shows what it has printed."
    )
