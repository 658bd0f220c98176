"""Permissions of a spot machine, each with a reason.

None names a whole service, or lets a machine start others or read secrets.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from drcli.store import keys

ANY = "*"


@dataclass(frozen=True)
class Permission:
    """`resources` may hold CloudFormation's variables."""

    action: str
    resources: tuple[str, ...]
    reason: str


@dataclass(frozen=True)
class Places:
    """The objects that a machine works with.

    Attributes:
        folders: Prefixes to read and write, without a final slash.
        upload_bucket: Empty if the same or none.
        key_arn: KMS key; empty for Amazon's own.
        log_group: Of CloudWatch, or empty.
    """

    bucket: str
    folders: tuple[str, ...]
    read_only: tuple[str, ...] = ()
    upload_bucket: str = ""
    upload_folder: str = ""
    key_arn: str = ""
    log_group: str = ""


def run_folders(prefix: str) -> tuple[str, ...]:
    folders = (
        keys.folder(prefix),
        keys.rollouts_folder(prefix),
        keys.run_folder(prefix),
        keys.training_records_folder(prefix),
    )
    return tuple(folder.rstrip("/") for folder in folders)


def permissions(places: Places, groups: Sequence[str], topic: str) -> list[Permission]:
    files = _objects(places.bucket, places.folders)
    reads = _objects(places.bucket, places.read_only)
    away = _objects(places.upload_bucket, (places.upload_folder,)) if places.upload_bucket else ()
    whole = tuple(_arn(name) for name in (places.bucket, places.upload_bucket) if name)
    own = tuple(
        "arn:${AWS::Partition}:autoscaling:${AWS::Region}:${AWS::AccountId}:autoScalingGroup:*:"
        f"autoScalingGroupName/{group}"
        for group in groups
    )
    written = (*files, *away)
    found = [
        Permission("s3:ListBucket", whole, "looks for the newest checkpoint and for rollouts"),
        Permission(
            "s3:GetObject",
            (*written, *reads),
            "reads settings, reward function, checkpoints and rollouts",
        ),
        Permission("s3:PutObject", written, "writes checkpoints, rollouts, metrics and logs"),
        Permission("s3:DeleteObject", written, "deletes rollouts that were learned from"),
        Permission(
            "s3:AbortMultipartUpload", written, "removes the parts of a large upload that failed"
        ),
        Permission("sns:Publish", (topic,), "reports the end of the training and failures"),
        Permission(
            "autoscaling:SetDesiredCapacity", own, "ends its own group when the training has ended"
        ),
        Permission("ec2:DescribeSpotPriceHistory", (ANY,), "knows what the machine costs per hour"),
        *_session_manager(),
    ]
    if places.log_group:
        group = (
            "arn:${AWS::Partition}:logs:${AWS::Region}:${AWS::AccountId}:log-group:"
            + places.log_group
        )
        streams = (f"{group}:log-stream:*",)
        found += [
            Permission("logs:CreateLogGroup", (group, f"{group}:*"), "makes the group of the logs"),
            Permission(
                "logs:CreateLogStream",
                (group, f"{group}:*", *streams),
                "makes a stream for each log",
            ),
            Permission("logs:PutLogEvents", streams, "sends the logs to CloudWatch"),
        ]
    if places.key_arn:
        found += [
            Permission("kms:Decrypt", (places.key_arn,), "reads objects that this key encrypts"),
            Permission(
                "kms:GenerateDataKey", (places.key_arn,), "writes objects that this key encrypts"
            ),
        ]
    return found


def policy(given: Sequence[Permission]) -> dict[str, Any]:
    ordered = sorted(given, key=lambda each: each.resources)
    statements: list[Mapping[str, Any]] = [
        {
            "Effect": "Allow",
            "Action": sorted(each.action for each in group),
            "Resource": [_filled(resource) for resource in resources],
        }
        for resources, group in groupby(ordered, key=lambda each: each.resources)
    ]
    return {"Version": "2012-10-17", "Statement": statements}


def _filled(resource: str) -> Any:
    return {"Fn::Sub": resource} if "${" in resource else resource


def _session_manager() -> list[Permission]:
    channels = ("CreateControlChannel", "CreateDataChannel", "OpenControlChannel")
    talks = "carries shells of `dr-spot ssh` without an open port"
    commands = ("AcknowledgeMessage", "DeleteMessage", "FailMessage", "GetEndpoint")
    receives = "receives the command of `dr-spot stop`"
    return [
        Permission("ssm:UpdateInstanceInformation", (ANY,), "tells Session Manager it is there"),
        *[Permission(f"ssmmessages:{n}", (ANY,), talks) for n in (*channels, "OpenDataChannel")],
        *[
            Permission(f"ec2messages:{n}", (ANY,), receives)
            for n in (*commands, "GetMessages", "SendReply")
        ],
    ]


def _arn(bucket: str) -> str:
    return "arn:${AWS::Partition}:s3:::" + bucket


def _objects(bucket: str, folders: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{_arn(bucket)}/{folder}/*" for folder in sorted(set(folders)))
