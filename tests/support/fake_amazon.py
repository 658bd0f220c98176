"""What a stack named `run` has at Amazon, made at moto: clients, its group, and its user data."""

from typing import Any

import boto3


def client(service: str, endpoint: str) -> Any:
    """A client with keys that may do everything."""
    return boto3.client(
        service,
        region_name="us-east-1",
        endpoint_url=endpoint,
        aws_access_key_id="testing",
        aws_secret_access_key="testing",
    )


def make_group(autoscaling: Any) -> None:
    """Make the group of machines, which wants none yet."""
    autoscaling.create_launch_configuration(
        LaunchConfigurationName="one", ImageId="ami-1e749f67", InstanceType="c7i.xlarge"
    )
    autoscaling.create_auto_scaling_group(
        AutoScalingGroupName="run",
        LaunchConfigurationName="one",
        MinSize=0,
        MaxSize=1,
        AvailabilityZones=["us-east-1a"],
    )


def machine_facts(topic: str, ends: float = 0.0) -> dict[str, Any]:
    """What the user data tell a machine of the stack."""
    return {
        "stack": "run",
        "bucket": "models",
        "region": "us-east-1",
        "domain": "amazonaws.com",
        "topic": topic,
        "groups": ["run"],
        "ends": ends,
    }
