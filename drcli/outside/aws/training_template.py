"""CloudFormation template of a training on one machine, replaced when taken away."""

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.resources import files
from itertools import groupby
from typing import Any, Literal

import yaml

from drcli.model import keys

# cloud-init's user data, with the boot program.


MOST_BYTES = 16_384
"""Amazon's limit."""


def user_data(bucket: str, groups: Sequence[str], topic: str, ends: float) -> str:
    """Names such as ${AWS::Region} are for CloudFormation; `ends` is Unix seconds, 0 for never."""
    facts = {
        "stack": "${AWS::StackName}",
        "bucket": bucket,
        "region": "${AWS::Region}",
        "domain": "${AWS::URLSuffix}",
        "topic": topic,
        "groups": list(groups),
        "ends": ends,
    }
    program = files("drcli.outside.aws").joinpath("boot.py").read_bytes()
    packed = base64.b64encode(gzip.compress(program, 9, mtime=0)).decode()
    content: dict[str, Any] = {
        "write_files": [
            {
                "path": "/etc/drcli/machine.json",
                "permissions": "0644",
                "content": json.dumps(facts) + "\n",
            },
            {
                "path": "/opt/drcli/boot.py",
                "permissions": "0755",
                "encoding": "gz+b64",
                "content": packed,
            },
        ],
        "runcmd": [["python3", "/opt/drcli/boot.py", "start"]],
    }
    text = "#cloud-config\n" + yaml.safe_dump(content, sort_keys=False, width=1_000_000)
    if len(text) > MOST_BYTES:
        raise ValueError(f"the user data have {len(text)} bytes, more than {MOST_BYTES}")
    return text


# Permissions of a spot machine, each with a reason.
#
# None names a whole service, or lets a machine start others or read secrets.


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


Architecture = Literal["x86_64", "arm64"]

STACK_TAG, MODEL_TAG, KIND_TAG = "drcli:stack", "drcli:model", "drcli:kind"
PATIENCE_MINUTES = 10
"""Without a spot machine, before an ordinary one starts."""


@dataclass(frozen=True)
class Image:
    id: str
    root_device: str = "/dev/sda1"


@dataclass(frozen=True)
class Group:
    """Which machines may train.

    Attributes:
        types: Preferred first.
        market: "spot-or-on-demand" starts an ordinary machine only without spot machines.
        most_usd: Per spot hour; None for the on-demand price.
        ends: Unix seconds; 0 for never.
    """

    types: Mapping[str, Architecture]
    images: Mapping[Architecture, Image]
    subnets: Sequence[str]
    network: str
    market: Literal["spot", "spot-or-on-demand", "on-demand"] = "spot"
    most_usd: float | None = None
    ends: float = 0.0
    disk_gb: int = 30
    key_name: str = ""


def group_names(group: Group) -> list[str]:
    more = ["${AWS::StackName}-on-demand"] if group.market == "spot-or-on-demand" else []
    return ["${AWS::StackName}", *more]


def training_template(stack: str, model: str, group: Group, places: Places, topic: str) -> Any:
    """An empty topic makes one."""
    names = group_names(group)
    topic_name = topic or "${Topic}"
    data = user_data(places.bucket, names, topic_name, group.ends)
    tags = _tags(stack, model)
    used = list(dict.fromkeys(group.types.values()))
    resources: dict[str, Any] = {
        "Role": _role(permissions(places, names, topic_name), tags),
        "Profile": _resource("IAM::InstanceProfile", Roles=[_ref("Role")]),
        "Firewall": _resource(
            "EC2::SecurityGroup",
            GroupDescription=f"drcli: machines of {stack}; no open port",
            VpcId=group.network,
            Tags=tags,
        ),
    }
    if not topic:
        resources["Topic"] = _resource("SNS::Topic", DisplayName="DeepRacer", Tags=tags)
    for kind in used:
        resources[_launch_template(kind)] = _machine(group, group.images[kind], data, tags)
    share = 100 if group.market == "on-demand" else 0
    resources["Group"] = _scaling_group(names[0], group, share, 1, tags)
    if group.ends:
        resources["End"] = _end("Group", group.ends)
    if group.market == "spot-or-on-demand":
        resources |= _fallback(names[1], group, tags)
    return {
        "AWSTemplateFormatVersion": "2010-09-09",
        "Description": f"drcli: training of {model}; made by dr-spot create, removed by dr-spot "
        "delete",
        "Resources": resources,
        "Outputs": {
            "Topic": {"Value": topic or _ref("Topic")},
            "Firewall": {"Value": _ref("Firewall")},
            "Group": {"Value": _ref("Group")},
            "Role": {"Value": _ref("Role")},
        },
    }


def _role(given: Any, tags: Any) -> Any:
    return _resource(
        "IAM::Role",
        AssumeRolePolicyDocument={
            "Version": "2012-10-17",
            "Statement": [
                {
                    "Effect": "Allow",
                    "Principal": {"Service": "ec2.amazonaws.com"},
                    "Action": "sts:AssumeRole",
                }
            ],
        },
        Policies=[{"PolicyName": "training", "PolicyDocument": policy(given)}],
        Tags=tags,
    )


def _machine(group: Group, image: Image, data: str, tags: Any) -> Any:
    disk = {
        "VolumeSize": group.disk_gb,
        "VolumeType": "gp3",
        "Encrypted": True,
        "DeleteOnTermination": True,
    }
    launch: dict[str, Any] = {
        "ImageId": image.id,
        "IamInstanceProfile": {"Arn": {"Fn::GetAtt": ["Profile", "Arn"]}},
        "SecurityGroupIds": [{"Fn::GetAtt": ["Firewall", "GroupId"]}],
        "MetadataOptions": {
            "HttpEndpoint": "enabled",
            "HttpTokens": "required",
            "HttpPutResponseHopLimit": 1,
        },
        "BlockDeviceMappings": [{"DeviceName": image.root_device, "Ebs": disk}],
        "InstanceInitiatedShutdownBehavior": "terminate",
        "TagSpecifications": [
            {"ResourceType": kind, "Tags": tags} for kind in ("instance", "volume")
        ],
        "UserData": {"Fn::Base64": {"Fn::Sub": data}},
    }
    if group.key_name:
        launch["KeyName"] = group.key_name
    return _resource("EC2::LaunchTemplate", LaunchTemplateData=launch)


def _scaling_group(name: str, group: Group, on_demand_percent: int, desired: int, tags: Any) -> Any:
    kinds = list(dict.fromkeys(group.types.values()))
    distribution: dict[str, Any] = {
        "OnDemandBaseCapacity": 0,
        "OnDemandPercentageAboveBaseCapacity": on_demand_percent,
        "OnDemandAllocationStrategy": "lowest-price",
        "SpotAllocationStrategy": "price-capacity-optimized",
    }
    if group.most_usd is not None:
        distribution["SpotMaxPrice"] = f"{group.most_usd:.4f}"
    return _resource(
        "AutoScaling::AutoScalingGroup",
        AutoScalingGroupName={"Fn::Sub": name},
        MinSize="0",
        MaxSize="1",
        DesiredCapacity=str(desired),
        VPCZoneIdentifier=list(group.subnets),
        CapacityRebalance=on_demand_percent == 0,
        HealthCheckType="EC2",
        MetricsCollection=[{"Granularity": "1Minute"}],
        MixedInstancesPolicy={
            "InstancesDistribution": distribution,
            "LaunchTemplate": {
                "LaunchTemplateSpecification": _version(kinds[0]),
                "Overrides": [
                    {"InstanceType": name, "LaunchTemplateSpecification": _version(kind)}
                    for name, kind in group.types.items()
                ],
            },
        },
        Tags=[{**tag, "PropagateAtLaunch": True} for tag in tags],
    )


def _end(group: str, ends: float) -> Any:
    """Works even if machine and racer's computer are dead."""
    moment = datetime.fromtimestamp(ends, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return _resource(
        "AutoScaling::ScheduledAction",
        AutoScalingGroupName=_ref(group),
        StartTime=moment,
        MinSize=0,
        MaxSize=0,
        DesiredCapacity=0,
    )


def _fallback(name: str, group: Group, tags: Any) -> dict[str, Any]:
    """An ordinary machine after some minutes without a spot machine.

    The model's lease keeps them apart: the second waits until the first has gone.
    """

    def policy_to(size: int) -> Any:
        return _resource(
            "AutoScaling::ScalingPolicy",
            AutoScalingGroupName=_ref("OnDemandGroup"),
            PolicyType="SimpleScaling",
            AdjustmentType="ExactCapacity",
            ScalingAdjustment=size,
            Cooldown="60",
        )

    def metric(identifier: str, metric_name: str) -> Any:
        dimensions = [{"Name": "AutoScalingGroupName", "Value": _ref("Group")}]
        found = {
            "Namespace": "AWS/AutoScaling",
            "MetricName": metric_name,
            "Dimensions": dimensions,
        }
        stat = {"Metric": found, "Period": 60, "Stat": "Maximum"}
        return {"Id": identifier, "MetricStat": stat, "ReturnData": False}

    missing = {"Id": "missing", "Expression": "wanted - running", "ReturnData": True}
    alarm = _resource(
        "CloudWatch::Alarm",
        AlarmDescription=f"No spot machine for {PATIENCE_MINUTES} minutes",
        ComparisonOperator="GreaterThanThreshold",
        Threshold=0,
        EvaluationPeriods=PATIENCE_MINUTES,
        DatapointsToAlarm=PATIENCE_MINUTES,
        TreatMissingData="notBreaching",
        Metrics=[
            metric("wanted", "GroupDesiredCapacity"),
            metric("running", "GroupInServiceInstances"),
            missing,
        ],
        AlarmActions=[_ref("UseOnDemand")],
        OKActions=[_ref("LeaveOnDemand")],
    )
    found = {
        "OnDemandGroup": _scaling_group(name, group, 100, 0, tags),
        "UseOnDemand": policy_to(1),
        "LeaveOnDemand": policy_to(0),
        "NoSpotMachine": alarm,
    }
    if group.ends:
        found["EndOnDemand"] = _end("OnDemandGroup", group.ends)
    return found


def _tags(stack: str, model: str) -> list[dict[str, str]]:
    found = {STACK_TAG: stack, MODEL_TAG: model, KIND_TAG: "training", "Name": f"drcli {stack}"}
    return [{"Key": key, "Value": value[:256]} for key, value in found.items()]


def _version(kind: str) -> Any:
    template = _launch_template(kind)
    return {
        "LaunchTemplateId": _ref(template),
        "Version": {"Fn::GetAtt": [template, "LatestVersionNumber"]},
    }


def _launch_template(kind: str) -> str:
    return "MachineArm" if kind == "arm64" else "MachineX86"


def _resource(kind: str, **properties: Any) -> Any:
    return {"Type": f"AWS::{kind}", "Properties": properties}


def _ref(name: str) -> dict[str, str]:
    return {"Ref": name}


# CloudFormation template of what trainings share.


UNFINISHED_DAYS = 2


def base_template(stack: str) -> Any:
    """The bucket outlives the stack: `dr-spot delete` asks before it deletes models."""
    tags = [
        {"Key": STACK_TAG, "Value": stack},
        {"Key": KIND_TAG, "Value": "base"},
        {"Key": "Name", "Value": f"drcli {stack}"},
    ]
    rule = {
        "Id": "unfinished-uploads",
        "Status": "Enabled",
        "AbortIncompleteMultipartUpload": {"DaysAfterInitiation": UNFINISHED_DAYS},
    }
    encryption = {"ServerSideEncryptionByDefault": {"SSEAlgorithm": "AES256"}}
    whole = [{"Fn::GetAtt": ["Bucket", "Arn"]}, {"Fn::Sub": "${Bucket.Arn}/*"}]
    return {
        "AWSTemplateFormatVersion": "2010-09-09",
        "Description": "drcli: bucket and topic of trainings; made by dr-spot create-base",
        "Resources": {
            "Bucket": {
                "Type": "AWS::S3::Bucket",
                "DeletionPolicy": "Retain",
                "UpdateReplacePolicy": "Retain",
                "Properties": {
                    "BucketEncryption": {
                        "ServerSideEncryptionConfiguration": [encryption],
                    },
                    "PublicAccessBlockConfiguration": {
                        "BlockPublicAcls": True,
                        "BlockPublicPolicy": True,
                        "IgnorePublicAcls": True,
                        "RestrictPublicBuckets": True,
                    },
                    "LifecycleConfiguration": {"Rules": [rule]},
                    "Tags": tags,
                },
            },
            "BucketPolicy": {
                "Type": "AWS::S3::BucketPolicy",
                "Properties": {
                    "Bucket": {"Ref": "Bucket"},
                    "PolicyDocument": {
                        "Version": "2012-10-17",
                        "Statement": [
                            {
                                "Sid": "OnlyEncryptedConnections",
                                "Effect": "Deny",
                                "Principal": "*",
                                "Action": "s3:*",
                                "Resource": whole,
                                "Condition": {"Bool": {"aws:SecureTransport": "false"}},
                            }
                        ],
                    },
                },
            },
            "Topic": {
                "Type": "AWS::SNS::Topic",
                "Properties": {"DisplayName": "DeepRacer", "Tags": tags},
            },
        },
        "Outputs": {
            "Bucket": {"Value": {"Ref": "Bucket"}},
            "Topic": {"Value": {"Ref": "Topic"}},
        },
    }
