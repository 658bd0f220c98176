"""The templates and the user data, checked by the programs that know their rules."""

import base64
import gzip
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from drcli.outside.aws import boot
from drcli.outside.aws.training_template import (
    MOST_BYTES,
    Group,
    Image,
    Places,
    base_template,
    run_folders,
    training_template,
    user_data,
)

PLACES = Places("models", (*run_folders("training/m"), "spot/run"), ("training/old",))
TOPIC = "arn:aws:sns:us-east-1:123456789012:races"


def template(topic: str = "", **changes):
    group = {
        "types": {"c7i.xlarge": "x86_64", "c7g.xlarge": "arm64"},
        "images": {"x86_64": Image("ami-12345678"), "arm64": Image("ami-87654321")},
        "subnets": ["subnet-12345678", "subnet-87654321"],
        "network": "vpc-12345678",
        "ends": 1_900_000_000.0,
        **changes,
    }
    return training_template("run", "training/m", Group(**group), PLACES, topic)


def resource(made, kind: str):
    return [x["Properties"] for x in made["Resources"].values() if x["Type"] == f"AWS::{kind}"]


def test_cfn_lint_finds_nothing(tmp_path: Path):
    made = {
        "spot": template(TOPIC, most_usd=0.1, key_name="mine"),
        "fallback": template(market="spot-or-on-demand"),
        "standard": template(market="on-demand", ends=0.0),
        "base": base_template("racing"),
    }
    for name, content in made.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    program = Path(sys.executable).with_name("cfn-lint")

    done = subprocess.run(
        [program, *sorted(tmp_path.glob("*.json"))], capture_output=True, text=True, check=False
    )

    assert (done.returncode, done.stdout) == (0, "")


def test_cloud_init_takes_the_user_data(tmp_path: Path):
    if shutil.which("cloud-init") is None:
        pytest.skip("the program cloud-init is not installed")
    (tmp_path / "user-data").write_text(user_data("models", ["run"], TOPIC, 0.0))

    done = subprocess.run(
        ["cloud-init", "schema", "-c", str(tmp_path / "user-data")],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stdout + done.stderr


def test_the_boot_program_is_in_the_user_data():
    text = user_data("models", ["run"], TOPIC, 0.0)
    files = {each["path"]: each for each in yaml.safe_load(text)["write_files"]}

    packed = files["/opt/drcli/boot.py"]["content"]
    assert gzip.decompress(base64.b64decode(packed)) == Path(boot.__file__).read_bytes()
    assert json.loads(files["/etc/drcli/machine.json"]["content"])["stack"] == "${AWS::StackName}"
    assert len(text) < MOST_BYTES


def test_machines_ask_for_tokens_have_encrypted_disks_and_no_open_port():
    made = template()

    for launch in (each["LaunchTemplateData"] for each in resource(made, "EC2::LaunchTemplate")):
        assert launch["MetadataOptions"]["HttpTokens"] == "required"
        assert launch["MetadataOptions"]["HttpPutResponseHopLimit"] == 1
        disk = launch["BlockDeviceMappings"][0]["Ebs"]
        assert (disk["Encrypted"], disk["VolumeType"]) == (True, "gp3")
        tags = {tag["Key"] for each in launch["TagSpecifications"] for tag in each["Tags"]}
        assert {"drcli:stack", "drcli:model", "drcli:kind"} <= tags
    assert "SecurityGroupIngress" not in resource(made, "EC2::SecurityGroup")[0]


def test_the_group_has_several_types_and_zones_and_takes_what_is_cheap_and_free():
    group = resource(template(), "AutoScaling::AutoScalingGroup")[0]
    policy = group["MixedInstancesPolicy"]

    assert policy["InstancesDistribution"]["SpotAllocationStrategy"] == "price-capacity-optimized"
    assert policy["InstancesDistribution"]["OnDemandPercentageAboveBaseCapacity"] == 0
    overrides = policy["LaunchTemplate"]["Overrides"]
    assert [each["InstanceType"] for each in overrides] == ["c7i.xlarge", "c7g.xlarge"]
    own = [each["LaunchTemplateSpecification"]["LaunchTemplateId"]["Ref"] for each in overrides]
    assert own == ["MachineX86", "MachineArm"]
    assert (group["MinSize"], group["MaxSize"], group["CapacityRebalance"]) == ("0", "1", True)
    assert len(group["VPCZoneIdentifier"]) == 2


def test_the_group_ends_without_its_machine():
    end = resource(template(), "AutoScaling::ScheduledAction")[0]

    assert end["StartTime"] == "2030-03-17T17:46:40Z"
    assert (end["MinSize"], end["MaxSize"], end["DesiredCapacity"]) == (0, 0, 0)
    assert resource(template(ends=0.0), "AutoScaling::ScheduledAction") == []


def test_an_ordinary_machine_takes_over_only_by_choice():
    assert len(resource(template(), "AutoScaling::AutoScalingGroup")) == 1

    made = template(market="spot-or-on-demand")

    _, second = resource(made, "AutoScaling::AutoScalingGroup")
    assert second["DesiredCapacity"] == "0"
    alone = resource(template(market="on-demand"), "AutoScaling::AutoScalingGroup")
    for group in (second, *alone):
        distribution = group["MixedInstancesPolicy"]["InstancesDistribution"]
        assert distribution["OnDemandPercentageAboveBaseCapacity"] == 100
    assert len(resource(made, "AutoScaling::ScheduledAction")) == 2
    alarm = resource(made, "CloudWatch::Alarm")[0]
    assert alarm["Metrics"][-1]["Expression"] == "wanted - running"
    assert alarm["AlarmActions"] == [{"Ref": "UseOnDemand"}]
    assert alarm["OKActions"] == [{"Ref": "LeaveOnDemand"}]


def test_a_stack_without_a_shared_topic_has_its_own():
    assert len(resource(template(), "SNS::Topic")) == 1
    assert resource(template(TOPIC), "SNS::Topic") == []


def test_the_bucket_is_private_encrypted_and_survives_its_stack():
    bucket = base_template("racing")["Resources"]["Bucket"]

    assert bucket["DeletionPolicy"] == "Retain"
    assert all(bucket["Properties"]["PublicAccessBlockConfiguration"].values())
    assert "BucketEncryption" in bucket["Properties"]
