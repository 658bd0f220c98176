"""CloudFormation template of a training on one machine, replaced when taken away."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Literal

from drcli.spot.role_permissions import Places, permissions, policy
from drcli.spot.user_data import user_data

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
