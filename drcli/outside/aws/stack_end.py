"""Ends a stack: stops training, checks the model, removes everything."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any

from drcli.base.errors import DrError, SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.base.report import counted
from drcli.bucket.s3_errors import error_code
from drcli.model import keys, lease
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_prefix import is_tensorflow, newest_checkpoint
from drcli.model.model_store import ModelStore
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.creation import forget_files
from drcli.outside.aws.machine_marks import ENDED, read_marks
from drcli.outside.aws.machines import Machine, machines_of
from drcli.outside.aws.stacks import Pause, Stack, delete_stack, our_stacks

with lazy_imports():
    from botocore import exceptions as boto

STOP_COMMAND = (
    "cd /opt/drcli/racer && set -a && . /opt/drcli/environment && "
    "exec runuser -u drcli -- /opt/drcli/venv/bin/dr-stop-training"
)
"""Run as root by Systems Manager."""

_POLL_S = 5.0
_DELIVERY_S = 60


@dataclass(frozen=True)
class StoppedStack:
    """What was stopped and removed."""

    stack: Annotated[str, "Name of the stack."]
    model: Annotated[str, "Prefix in the bucket."]
    checkpoint: Annotated[str, "Newest one in the bucket, or empty."]
    machines: Annotated[tuple[str, ...], "Machines that ran."]
    objects: Annotated[int, "Objects removed from the bucket; models stay."]
    whole: Annotated[bool, "Whether its files are whole."] = False

    def __str__(self) -> str:
        if not self.checkpoint:
            return f"Removed {self.stack}. There is no checkpoint of {self.model}."
        state = "is whole" if self.whole else "was not checked"
        return (
            f"Removed {self.stack}. The model {self.model} stays in the bucket. Its newest "
            f"checkpoint, {self.checkpoint}, {state}."
        )


@dataclass(frozen=True)
class BucketContent:
    bucket: str
    objects: int
    size_bytes: int
    models: tuple[str, ...]

    def __str__(self) -> str:
        models = f", among them the models {', '.join(self.models)}" if self.models else ""
        size = f"{counted(self.objects, 'object')} with {self.size_bytes / 1e6:,.1f} MB"
        return f"The bucket {self.bucket} holds {size}{models}."


def stop_training_there(
    account: Account,
    stack: Stack,
    *,
    patience_s: float,
    pause: Pause = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> tuple[str, ...]:
    """Stop the training and wait; returns the machines.

    Raises:
        StorageError: A machine cannot be asked, or does not stop in time.
    """
    bucket = account.bucket(stack.bucket)
    there = _running(account, stack)
    asked = [each.instance for each in there if each.said not in ENDED]
    if not asked:
        return tuple(each.instance for each in there)
    command = _send(account, asked)
    until = clock() + patience_s
    while True:
        states = {mark.instance: mark.state for mark in read_marks(bucket, stack.name)}
        left = [name for name in asked if states.get(name) not in ENDED]
        if (
            left
            and lease.holder(ModelStore(bucket, stack.model)) is None
            and _done(account, command, left)
        ):
            left = []  # it had no training that could say so
        if not left:
            return tuple(each.instance for each in there)
        if clock() >= until:
            raise StorageError(
                f"The training on {', '.join(left)} has not stopped within {patience_s:.0f} s; "
                "nothing was deleted.",
                remedy=f"Wait and repeat this, look with `dr-spot logs {stack.name}`, or "
                "give up what is not in the bucket with --now.",
            )
        pause(_POLL_S)


def verified_checkpoint(account: Account, stack: Stack) -> str:
    """The newest checkpoint if its files are whole.

    Empty without one, or for the reference's, whose files are not checked.

    Raises:
        StorageError: Its files are not whole, or still being written.
    """
    bucket = account.bucket(stack.bucket)
    store = ModelStore(bucket, stack.model)
    model = f"s3://{stack.bucket}/{stack.model}"
    held = lease.holder(store)
    if held is not None:
        raise StorageError(
            f"{model} is still being trained by {held.owner}; nothing was deleted.",
            remedy="Repeat this in a minute, or give up what is not in the bucket with --now.",
        )
    newest = newest_checkpoint(store)
    if newest is None:
        return ""
    listed = [info.key for info in bucket.list(keys.model_folder(stack.model))]
    if is_tensorflow(listed, stack.model, str(newest)):
        return ""  # no machine has trained on it yet
    loaded = CheckpointStore(store).load_latest()
    if loaded is None or loaded.record.name != str(newest):
        raise StorageError(
            f"The newest checkpoint of {model}, {newest}, is not whole; nothing was deleted.",
            remedy="Look at it with `dr-list-models`; --now deletes the stack all the same. "
            "The model stays in the bucket.",
        )
    return str(newest)


def end_groups(account: Account, stack: Stack) -> None:
    """Set the groups to 0."""
    for group in stack.groups:
        # That code says that there is no such group.
        with account.trying(f"end the machines of {group}", unless=("ValidationError",)):
            account.client("autoscaling").update_auto_scaling_group(
                AutoScalingGroupName=group, MinSize=0, DesiredCapacity=0
            )


def remove_training(
    account: Account, stack: Stack, checkpoint: str, pause: Pause = time.sleep
) -> StoppedStack:
    """End the machines, and delete stack and files; models stay."""
    there = tuple(each.instance for each in _running(account, stack))
    with suppress(DrError):  # a stack that was never made has no groups
        end_groups(account, stack)
    delete_stack(account, stack.name, pause)
    bucket = account.bucket(stack.bucket)
    objects = forget_files(bucket, stack.name)
    newest = checkpoint or str(newest_checkpoint(ModelStore(bucket, stack.model)) or "")
    return StoppedStack(stack.name, stack.model, newest, there, objects, whole=bool(checkpoint))


def content_of_bucket(account: Account, stack: Stack) -> BucketContent | None:
    """None if a base stack has no bucket any more.

    Raises:
        SettingsError: A training uses it.
    """
    users = [
        each.name
        for each in our_stacks(account)
        if each.kind == "training" and each.bucket == stack.bucket
    ]
    if users:
        raise SettingsError(
            f"The bucket {stack.bucket} of {stack.name} is used by the stacks {', '.join(users)}.",
            remedy=f"Remove them first, as with `dr-spot delete {users[0]}`.",
        )
    found: list[Any] | None = None
    with account.trying(f"list the bucket {stack.bucket}", unless=("NoSuchBucket",)):
        found = account.pages("s3", "list_objects_v2", "Contents", Bucket=stack.bucket)
    if found is None:
        return None
    pointer = "/model/.coach_checkpoint"
    models = [each["Key"].removesuffix(pointer) for each in found if each["Key"].endswith(pointer)]
    size = sum(each["Size"] for each in found)
    return BucketContent(stack.bucket, len(found), size, tuple(sorted(models)))


def remove_base(
    account: Account, stack: Stack, *, keep_bucket: bool, pause: Pause = time.sleep
) -> None:
    """Delete a base stack, and its bucket unless that is kept."""
    delete_stack(account, stack.name, pause)
    if keep_bucket:
        return

    client = account.client("s3")
    with account.trying(f"delete the bucket {stack.bucket}", unless=("NoSuchBucket",)):
        pages = client.get_paginator("list_object_versions").paginate(Bucket=stack.bucket)
        for page in pages:
            entries = [*page.get("Versions", []), *page.get("DeleteMarkers", [])]
            objects = [{"Key": each["Key"], "VersionId": each["VersionId"]} for each in entries]
            if objects:
                _delete_versions(client, stack.bucket, objects)
        client.delete_bucket(Bucket=stack.bucket)


def _delete_versions(client: Any, bucket: str, objects: Sequence[dict[str, str]]) -> None:
    answer = client.delete_objects(Bucket=bucket, Delete={"Objects": objects, "Quiet": True})
    for failure in answer.get("Errors", []):
        raise StorageError(
            f"{bucket}/{failure['Key']} cannot be deleted: {failure.get('Message')}.",
            remedy="Check the policy of the bucket and whether its objects are locked.",
        )


def _running(account: Account, stack: Stack) -> list[Machine]:
    marks = read_marks(account.bucket(stack.bucket), stack.name)
    return [each for each in machines_of(account, stack, marks) if each.running]


def _send(account: Account, instances: Sequence[str]) -> str:
    with account.trying("ask the machine to stop the training"):
        try:
            answer = account.client("ssm").send_command(
                InstanceIds=list(instances),
                DocumentName="AWS-RunShellScript",
                Comment="dr-spot stop",
                TimeoutSeconds=_DELIVERY_S,
                Parameters={"commands": [STOP_COMMAND]},
            )
        except boto.ClientError as error:
            if error_code(error) != "InvalidInstanceId":
                raise
            raise StorageError(
                f"The machine {', '.join(instances)} does not answer Systems Manager; it may "
                "still be booting. Nothing was deleted.",
                remedy="Repeat this in two minutes, or give up what is not in the bucket with "
                "--now.",
            ) from error
    return str(answer["Command"]["CommandId"])


def _done(account: Account, command: str, instances: Sequence[str]) -> bool:
    ask = account.client("ssm").get_command_invocation
    with suppress(boto.ClientError):  # not delivered yet
        answers = [ask(CommandId=command, InstanceId=instance) for instance in instances]
        return all(answer["Status"] == "Success" for answer in answers)
    return False
