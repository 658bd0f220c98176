"""drcli's CloudFormation stacks."""

import ipaddress
import json
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from drcli.base.errors import DrError, SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.bucket.s3_errors import error_code, error_text
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.training_template import KIND_TAG, MODEL_TAG, STACK_TAG

with lazy_imports():
    from botocore import exceptions as boto

BUCKET_TAG, ENDS_TAG = "drcli:bucket", "drcli:ends"

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9-]{0,63}")
_POLL_S, _PATIENCE_S = 5.0, 1200.0

Pause = Callable[[float], None]


@dataclass(frozen=True)
class Stack:
    """A stack of ours; `created` is Unix seconds."""

    name: str
    status: str
    created: float
    tags: Mapping[str, str]
    outputs: Mapping[str, str]

    @property
    def kind(self) -> str:
        """`training` or `base`."""
        return self.tags.get(KIND_TAG, "")

    @property
    def model(self) -> str:
        return self.tags.get(MODEL_TAG, "")

    @property
    def bucket(self) -> str:
        return self.outputs.get("Bucket") or self.tags.get(BUCKET_TAG, "")

    @property
    def ends(self) -> float:
        """Unix seconds; 0 for never."""
        text = self.tags.get(ENDS_TAG, "")
        return float(text) if text.isdigit() else 0.0

    @property
    def groups(self) -> tuple[str, ...]:
        return (self.name, f"{self.name}-on-demand")


def check_name(name: str) -> None:
    """V-01; raises SettingsError for a name that Amazon would refuse."""
    if not _NAME.fullmatch(name):
        raise SettingsError(
            f"'{name[:80]}' cannot be the name of a stack (rule V-01).",
            remedy="Use at most 64 letters, digits and hyphens, with a letter at the beginning.",
        )


def find_stack(account: Account, name: str) -> Stack | None:
    """Raises SettingsError for a stack of others."""
    check_name(name)
    with account.trying(f"look for the stack {name}"):
        try:
            answer = account.client("cloudformation").describe_stacks(StackName=name)
        except boto.ClientError as error:
            if error_code(error) == "ValidationError" and "not exist" in error_text(error):
                return None
            raise
    stack = _stack(answer["Stacks"][0])
    if not stack.kind:
        raise SettingsError(
            f"The stack {name} in {account.region} was not made by drcli.",
            remedy="Choose another name.",
        )
    return stack


def need_stack(account: Account, name: str, kind: str = "") -> Stack:
    """Raises SettingsError without a stack of this kind."""
    found = find_stack(account, name)
    if found is None:
        raise SettingsError(
            f"There is no stack {name} in {account.region}.",
            remedy="`dr-spot list` shows all; --region chooses another region.",
        )
    if kind and found.kind != kind:
        made = {"base": "dr-spot create-base", "training": "dr-spot create"}
        raise SettingsError(
            f"The stack {name} is a {found.kind} stack, not a {kind} stack.",
            remedy=f"Name one that `{made[kind]}` has made; `dr-spot list` shows all.",
        )
    return found


def our_stacks(account: Account) -> list[Stack]:
    """All in the region, by name."""
    with account.trying(f"list the stacks in {account.region}"):
        found = account.pages("cloudformation", "describe_stacks", "Stacks")
    return sorted((each for each in map(_stack, found) if each.kind), key=lambda each: each.name)


def create_stack(
    account: Account,
    name: str,
    template: Any,
    tags: Mapping[str, str],
    *,
    roles: bool,
    pause: Pause = time.sleep,
) -> Stack:
    """Make a stack and wait; a failure leaves nothing.

    Raises:
        SettingsError: A stack has that name.
        StorageError: It cannot be made, and why.
    """
    client = account.client("cloudformation")
    with account.trying(f"make the stack {name}"):
        try:
            stack_id = client.create_stack(
                StackName=name,
                TemplateBody=json.dumps(template),
                Tags=[{"Key": key, "Value": value} for key, value in tags.items()],
                Capabilities=["CAPABILITY_IAM"] if roles else [],
                OnFailure="DELETE",
            )["StackId"]
        except boto.ClientError as error:
            if error_code(error) == "AlreadyExistsException":
                raise _exists(account, name) from error
            raise
        status = _settled(account, stack_id, pause)
    if status == "CREATE_COMPLETE":
        return need_stack(account, name)
    raise StorageError(
        f"The stack {name} could not be made: {_reason(account, stack_id) or status}.",
        remedy="Nothing of it is left. Correct what that sentence names, and repeat the command.",
    )


def delete_stack(account: Account, name: str, pause: Pause = time.sleep) -> None:
    """Raises StorageError, with the reason."""
    with account.trying(f"delete the stack {name}"):
        client = account.client("cloudformation")
        stack_id = client.describe_stacks(StackName=name)["Stacks"][0]["StackId"]
        client.delete_stack(StackName=name)
        status = _settled(account, stack_id, pause)
    if status != "DELETE_COMPLETE":
        raise StorageError(
            f"The stack {name} could not be deleted: {_reason(account, stack_id) or status}.",
            remedy=f"Repeat `dr-spot delete {name}`; if it fails again, delete the stack in the "
            "console of CloudFormation, which shows what is in the way.",
        )


def refuse_existing(account: Account, name: str) -> None:
    if find_stack(account, name) is not None:
        raise _exists(account, name)


def _exists(account: Account, name: str) -> DrError:
    return SettingsError(
        f"There is a stack {name} in {account.region} already.",
        remedy=f"Choose another name, or remove that one with `dr-spot delete {name}`.",
    )


def _settled(account: Account, stack_id: str, pause: Pause) -> str:
    client = account.client("cloudformation")
    waited_s = 0.0
    while True:
        status = str(client.describe_stacks(StackName=stack_id)["Stacks"][0]["StackStatus"])
        if not status.endswith("_IN_PROGRESS") or waited_s >= _PATIENCE_S:
            return status
        pause(_POLL_S)
        waited_s += _POLL_S


def _reason(account: Account, stack_id: str) -> str:
    events = account.pages(
        "cloudformation", "describe_stack_events", "StackEvents", StackName=stack_id
    )
    for event in reversed(events):
        said = event.get("ResourceStatusReason", "")
        if event.get("ResourceStatus", "").endswith("_FAILED") and "cancelled" not in said:
            return f"{event.get('LogicalResourceId')}: {' '.join(said.split())}".rstrip(".")
    return ""


def _stack(entry: Mapping[str, Any]) -> Stack:
    tags = {tag["Key"]: tag["Value"] for tag in entry.get("Tags", [])}
    return Stack(
        entry["StackName"],
        entry["StackStatus"],
        entry["CreationTime"].timestamp(),
        tags if tags.get(STACK_TAG) == entry["StackName"] else {},
        {each["OutputKey"]: each["OutputValue"] for each in entry.get("Outputs", [])},
    )


# Access to a stack: addresses of machines and of mail.


def subscribe(account: Account, topic: str, email: str) -> None:
    """The receiver of the mail must agree first."""
    with account.trying(f"send messages to {email}"):
        account.client("sns").subscribe(TopicArn=topic, Protocol="email", Endpoint=email)


def add_access(account: Account, stack: Stack, address: str) -> str:
    """Open port 22 of a stack to one address; returns its range.

    Raises:
        SettingsError: It is not a single address.
    """
    try:
        single = ipaddress.ip_address(address.removesuffix("/32").removesuffix("/128"))
    except ValueError as error:
        raise SettingsError(
            f"'{address[:80]}' is not the address of one machine.",
            remedy="Give your own public address, as in 203.0.113.7.",
        ) from error
    if single.is_unspecified or single.is_private:
        raise SettingsError(
            f"{single} is not an address that machines at Amazon see.",
            remedy="Give your public address, which https://checkip.amazonaws.com shows.",
        )
    note = "drcli: added by dr-spot add-access"
    ranges, key = ("IpRanges", "CidrIp") if single.version == 4 else ("Ipv6Ranges", "CidrIpv6")
    added = str(ipaddress.ip_network(single))
    rule = {"IpProtocol": "tcp", "FromPort": 22, "ToPort": 22}
    rule[ranges] = [{key: added, "Description": note}]
    with account.trying(f"open port 22 for {single}", unless=("InvalidPermission.Duplicate",)):
        account.client("ec2").authorize_security_group_ingress(
            GroupId=stack.outputs["Firewall"], IpPermissions=[rule]
        )
    return added
