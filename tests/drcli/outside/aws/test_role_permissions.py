"""Every permission of a machine's role is needed: without it, something fails."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import requests

from drcli.base.errors import StorageError
from drcli.bucket import endpoint as profiles
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.outside.aws import boot
from drcli.outside.aws.training_template import (
    ANY,
    Permission,
    Places,
    permissions,
    policy,
    run_folders,
)
from fake_amazon import client, machine_facts, make_group
from fake_machine import FakeMachine

MODEL = "training/m"
PLACES = Places("models", (*run_folders(MODEL), "spot/run"))
TOPIC = "arn:aws:sns:us-east-1:123456789012:races"

TRIED = (
    "autoscaling:SetDesiredCapacity",
    "ec2:DescribeSpotPriceHistory",
    "s3:DeleteObject",
    "s3:GetObject",
    "s3:ListBucket",
    "s3:PutObject",
    "sns:Publish",
)
"""What moto can refuse. It knows no Systems Manager agent, and no key of KMS for a bucket; and it
does not check who aborts an upload."""

UNTRIED = {"s3:AbortMultipartUpload"}

WITHOUT_PLACES = {"sns:Publish", "autoscaling:SetDesiredCapacity", "s3:DeleteObject"}
"""For them moto compares no resource, or that of the bucket where an object is deleted."""


def filled(resource: str) -> str:
    for name, value in {
        "AWS::Partition": "aws",
        "AWS::Region": "us-east-1",
        "AWS::AccountId": "123456789012",
        "AWS::StackName": "run",
    }.items():
        resource = resource.replace("${" + name + "}", value)
    return resource


def given() -> list[Permission]:
    found = permissions(PLACES, ["${AWS::StackName}"], TOPIC)
    return [
        Permission(each.action, tuple(map(filled, each.resources)), each.reason) for each in found
    ]


class Role:
    """A role at moto, and a machine that has it."""

    def __init__(self, endpoint: str, root: Path) -> None:
        self.endpoint = endpoint
        self.check(False)
        self.iam = client("iam", endpoint)
        client("s3", endpoint).create_bucket(Bucket="models")
        client("sns", endpoint).create_topic(Name="races")
        make_group(client("autoscaling", endpoint))
        trust = {"Version": "2012-10-17", "Statement": []}
        role = self.iam.create_role(RoleName="run", AssumeRolePolicyDocument=json.dumps(trust))
        keys = client("sts", endpoint).assume_role(
            RoleArn=role["Role"]["Arn"], RoleSessionName="machine"
        )["Credentials"]
        self.keys = {
            "AccessKeyId": keys["AccessKeyId"],
            "SecretAccessKey": keys["SecretAccessKey"],
            "Token": keys["SessionToken"],
        }
        self.machine = FakeMachine(root, machine_facts(TOPIC), endpoint, self.keys)

    def check(self, wanted: bool) -> None:
        """Let moto check permissions, or not."""
        address = f"{self.endpoint}/moto-api/reset-auth"
        requests.post(address, data="0" if wanted else "inf", timeout=10)

    def allow(self, allowed: list[Permission]) -> None:
        """Let the role do this."""
        self.check(False)
        document = json.dumps(
            policy(
                [
                    replace(each, resources=(ANY,)) if each.action in WITHOUT_PLACES else each
                    for each in allowed
                ]
            )
        )
        self.iam.put_role_policy(RoleName="run", PolicyName="p", PolicyDocument=document)
        self.check(True)


@pytest.fixture(scope="module")
def role(moto_address: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Role]:
    made = Role(moto_address, tmp_path_factory.mktemp("machine"))
    yield made
    made.check(False)
    made.machine.close()


@pytest.fixture
def deed(role: Role, monkeypatch: pytest.MonkeyPatch):
    """Does one thing that a machine does; returns what Amazon says against it."""
    monkeypatch.setattr(boot, "ROOT", str(role.machine.root))
    monkeypatch.setattr(boot, "_metadata", role.machine.metadata.address)
    monkeypatch.setenv("AWS_ENDPOINT_URL", role.endpoint)
    monkeypatch.setenv("DRCLI_SPOT_PAUSE_S", "0")
    for name, key in {
        "ACCESS_KEY_ID": "AccessKeyId",
        "SECRET_ACCESS_KEY": "SecretAccessKey",
    }.items():
        monkeypatch.setenv(f"AWS_{name}", role.keys[key])
    monkeypatch.setenv("AWS_SESSION_TOKEN", role.keys["Token"])
    machine = boot.Machine()
    profiles.session_of.cache_clear()
    bucket = S3Bucket(Endpoint(role.endpoint), "models", patience_s=0.0)
    key = f"{MODEL}/model/1_Step-1.ckpt.json"
    topic = {"TopicArn": TOPIC, "Subject": "s", "Message": "m"}
    group = {"AutoScalingGroupName": "run", "DesiredCapacity": "0"}
    deeds = {
        "autoscaling:SetDesiredCapacity": lambda: machine.ask(
            "autoscaling", "2011-01-01", "SetDesiredCapacity", **group
        ),
        "ec2:DescribeSpotPriceHistory": lambda: machine.hourly_price({}),
        "s3:DeleteObject": lambda: bucket.delete([key]),
        "s3:GetObject": lambda: bucket.get(key),
        "s3:ListBucket": lambda: bucket.list(f"{MODEL}/"),
        "s3:PutObject": lambda: bucket.put(key, b"{}"),
        "sns:Publish": lambda: machine.ask("sns", "2010-03-31", "Publish", **topic),
    }

    def refusal(action: str) -> str:
        try:
            deeds[action]()
        except (StorageError, boot.BootFailed) as error:
            return str(error)
        return ""

    yield refusal
    profiles.session_of.cache_clear()


def test_the_whole_role_does_everything(role, deed):
    role.allow(given())

    assert {action: deed(action) for action in reversed(TRIED)} == dict.fromkeys(TRIED, "")


@pytest.mark.parametrize("action", TRIED)
def test_without_a_permission_what_needs_it_fails(role, deed, action):
    role.allow([each for each in given() if each.action != action])

    refusal = deed(action)

    assert any(word in refusal for word in ("lack the permission", "AccessDenied", "answers 403"))


def test_what_moto_cannot_try_has_a_reason():
    actions = {each.action for each in given()}
    agent = {name for name in actions if name.startswith(("ssm:", "ssmmessages:", "ec2messages:"))}

    assert actions == {*TRIED, *UNTRIED} | agent
    assert all(each.reason for each in given())


def test_only_what_amazon_limits_to_nothing_is_allowed_everywhere():
    anywhere = {each.action for each in given() if ANY in each.resources}

    assert {name for name in anywhere if not name.startswith(("ssm", "ec2messages"))} == {
        "ec2:DescribeSpotPriceHistory"
    }
    assert not [each for each in given() if "*" in each.action]


def test_objects_outside_the_folders_of_the_model_cannot_be_touched():
    for each in given():
        if each.action in ("s3:PutObject", "s3:DeleteObject", "s3:GetObject"):
            assert all(
                resource.startswith("arn:aws:s3:::models/") and resource != "arn:aws:s3:::models/*"
                for resource in each.resources
            )


def test_another_bucket_for_uploads_and_its_own_key_are_allowed_only_where_they_are_used():
    key = "arn:aws:kms:us-east-1:123456789012:key/k"
    other = Places("models", ("m",), upload_bucket="away", upload_folder="up/m", key_arn=key)

    actions = {each.action: each.resources for each in permissions(other, ["g"], TOPIC)}

    assert "arn:${AWS::Partition}:s3:::away/up/m/*" in actions["s3:PutObject"]
    assert actions["kms:Decrypt"] == (key,)
    assert "kms:Decrypt" not in {each.action for each in given()}


def test_logs_may_be_sent_to_their_own_group_only_where_the_settings_want_it():
    sends = replace(PLACES, log_group="/deepracer-for-cloud")

    found = [each for each in permissions(sends, ["g"], TOPIC) if each.action.startswith("logs:")]

    assert {each.action for each in found} == {
        "logs:CreateLogGroup",
        "logs:CreateLogStream",
        "logs:PutLogEvents",
    }
    resources = [filled(resource) for each in found for resource in each.resources]
    group = "arn:aws:logs:us-east-1:123456789012:log-group:/deepracer-for-cloud"
    assert all(resource == group or resource.startswith(f"{group}:") for resource in resources)
    assert not [each for each in given() if each.action.startswith("logs:")]
