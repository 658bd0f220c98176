"""What `dr-spot list` says about stacks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from drcli.base.errors import DrError
from drcli.model import keys, lease
from drcli.model.model_prefix import newest_checkpoint
from drcli.model.model_store import ModelStore
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.machine_marks import read_marks
from drcli.outside.aws.machines import Machine, cost_of, machines_of, scaling_problem
from drcli.outside.aws.stacks import Stack


@dataclass(frozen=True)
class StackReport:
    """A stack, its machines and its training.

    Attributes:
        stack: Name of the stack.
        kind: `training` or `base`.
        status: CloudFormation's word.
        state: In a word: `training`, `booting`, `failed`, ...
        reason: Why, as a sentence, or empty.
        model: Prefix in the bucket.
        bucket: Name of the bucket.
        checkpoint: Newest one, or empty.
        machines: The oldest first.
        usd: Cost so far; None if unknown or not asked for.
        created: When the stack was made, in Unix seconds.
        ends: When the machines end, in Unix seconds; 0 for never.
    """

    stack: str
    kind: str
    status: str
    state: str
    reason: str
    model: str
    bucket: str
    checkpoint: str
    machines: tuple[Machine, ...]
    usd: float | None
    created: float
    ends: float


@dataclass(frozen=True)
class StackReports:
    """All stacks of a region.

    Attributes:
        region: AWS region.
        stacks: By name.
    """

    region: str
    stacks: list[StackReport]


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
    state, reason = _state(machines, owned=owned)
    if state == "waiting for a machine":
        reason = scaling_problem(account, stack)
    return replace(report, state=state, reason=reason or report.reason)


def _state(machines: Sequence[Machine], *, owned: bool) -> tuple[str, str]:
    there = [each for each in machines if each.running]
    if there:
        last = there[-1]
        if last.said in ("training", "waiting", "restarting"):
            return ("training" if owned else last.said), last.reason
        return last.said or "booting", last.reason
    if machines and machines[-1].said in ("finished", "stopped", "failed"):
        return machines[-1].said, machines[-1].reason
    return "waiting for a machine", ""
