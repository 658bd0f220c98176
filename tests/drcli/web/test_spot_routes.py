"""Spot trainings on the page, at Amazon as moto plays it in this process."""

import json
from collections.abc import Iterator
from pathlib import Path

import boto3
import pytest
from moto import mock_aws

from amazon_server import amazon_server
from drcli.base.clock import wait_until
from drcli.bucket import endpoint
from drcli.outside.aws import creation, instance_types, racer_files, stacks
from drcli.outside.aws.aws_account import Account
from drcli.outside.aws.racer_files import InstallSource
from drcli.outside.aws.training_template import KIND_TAG, MODEL_TAG, STACK_TAG
from drcli.run import stack_plan
from drcli.web import spot_routes

REGION = "us-east-1"
PLAN = {"stack": "run", "bucket": "models", "ttl_minutes": 120}


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    endpoint.session_of.cache_clear()
    for name in ("AWS_PROFILE", "AWS_ENDPOINT_URL", "AWS_REGION", "AWS_SESSION_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("AWS_DEFAULT_REGION", REGION)
    monkeypatch.setenv("AWS_CONFIG_FILE", "/nonexistent")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", "/nonexistent")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "testing")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "testing")
    yield
    endpoint.session_of.cache_clear()


@pytest.fixture
def amazon(keys: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[Account]:
    """An account with a bucket, and what takes long replaced: other tests are about it."""
    monkeypatch.setattr(
        spot_routes, "in_subprocess", lambda progress, work, *given, heavy: work(progress, *given)
    )
    monkeypatch.setattr(stacks, "_POLL_S", 0.0)
    image = "/aws/service/ami-amazon-linux-latest/al2023-ami-kernel-default-x86_64"
    monkeypatch.setattr(instance_types, "IMAGE_NAMES", {"x86_64": image})
    # moto makes up another price each time.
    monkeypatch.setattr(creation, "current_prices", lambda *_: {"a": 0.07, "b": 0.11})
    wheel = InstallSource("", "drcli-9-py3-none-any.whl", b"a wheel")
    monkeypatch.setattr(racer_files, "find_source", lambda _: wheel)
    monkeypatch.setattr(
        stack_plan, "check_settings", lambda *given: stack_plan.Checked(given[4], {}, {}, [])
    )
    with mock_aws():
        boto3.client("s3", REGION).create_bucket(Bucket="models")
        yield Account(REGION, None)


@pytest.fixture
def training(amazon: Account) -> str:
    """A stack of a training, without machines."""
    tags = {
        STACK_TAG: "run",
        KIND_TAG: "training",
        MODEL_TAG: "training/m",
        stacks.BUCKET_TAG: "models",
    }
    boto3.client("cloudformation", REGION).create_stack(
        StackName="run",
        TemplateBody=json.dumps({"Resources": {"Topic": {"Type": "AWS::SNS::Topic"}}}),
        Tags=[{"Key": key, "Value": value} for key, value in tags.items()],
    )
    return "run"


def ended(client, name, body):
    """The task of a request, when it has ended."""
    number = client.post(f"/api/spot/{name}", json=body).json()["task"]
    task = {}

    def is_over():
        task.update(client.get(f"/api/tasks/{number}").json())
        return task["ended"] is not None

    assert wait_until(is_over, patience_s=60.0)
    return task


def test_without_access_keys_the_page_says_what_is_missing(client, keys, monkeypatch):
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")

    error = client.get("/api/spot").json()["error"]

    assert "no access keys for Amazon were found" in error["message"]
    assert "with DR_LOCAL_S3_PROFILE on the page “Settings”." in error["remedy"]


@pytest.fixture
def server(keys: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Amazon for other processes too."""
    with amazon_server() as address:
        monkeypatch.setenv("AWS_ENDPOINT_URL", address)
        yield


@pytest.mark.filterwarnings("ignore:Tried to parse")  # moto makes no policies of buckets
def test_a_bucket_is_made_listed_and_deleted(client, server):
    """In processes of their own, which the end of the console does not cut."""
    made = ended(client, "base", {"stack": "racing"})
    found = client.get("/api/spot").json()

    assert made["state"] == "done", made["error"]
    assert [(each["stack"], each["kind"]) for each in found["stacks"]] == [("racing", "base")]
    assert found["bucket"] == ""  # the settings name a local one
    question = client.get("/api/spot/question?about=delete&stack=racing").json()
    assert ("holds 0 objects" in question["intro"], question["confirm"]) == (True, "racing")
    assert client.post("/api/spot/delete", json={"stack": "racing"}).status_code == 400
    assert ended(client, "delete", {"stack": "racing", "confirm": "racing"})["state"] == "done"
    assert client.get("/api/spot").json()["stacks"] == []


def test_a_price_is_said_before_anything_is_made_and_must_not_have_risen(client, amazon):
    plan = ended(client, "plan", PLAN)
    none_made = client.get("/api/spot").json()["stacks"]
    risen = ended(client, "create", PLAN | {"agreed_usd_per_hour": 0.1})

    assert none_made == []
    assert any("0.070 to 0.110 USD per hour" in line for line in plan["result"]["said"])
    assert plan["result"]["most_usd_per_hour"] == 0.11
    assert "is up to 0.110 USD per hour now; nothing was started" in risen["error"]["message"]
    assert client.get("/api/spot").json()["stacks"] == []


def test_a_training_is_started_for_the_price_that_was_agreed(client, amazon):
    made = ended(client, "create", PLAN | {"agreed_usd_per_hour": 0.11})

    assert made["state"] == "done", made["error"]
    assert [each["model"] for each in client.get("/api/spot").json()["stacks"]] == ["model"]


def test_a_start_without_an_agreed_price_is_refused(client, amazon):
    answer = client.post("/api/spot/create", json=PLAN)

    assert answer.status_code == 400
    assert "agreed_usd_per_hour" in answer.json()["error"]["message"]


def test_logs_are_read_and_a_training_is_deleted(client, amazon, training):
    nothing = client.get("/api/spot/logs?stack=run")
    amazon.bucket("models").put("training/m/logs/trainer/trainer.log", b"one\ntwo\n")
    logs = client.get("/api/spot/logs?stack=run").json()

    assert "has no log" in nothing.json()["error"]["message"]
    assert logs["log"] == "training/m/logs/trainer/trainer.log"
    assert logs["lines"] == ["one", "two"]
    gone = ended(client, "delete", {"stack": "run", "confirm": "run"})
    assert gone["result"] == "Removed run. There is no checkpoint of training/m."


def test_a_training_is_stopped(client, amazon, training):
    stopped = ended(client, "stop", {"stack": "run"})

    assert stopped["state"] == "done", stopped["error"]
    assert client.get("/api/spot").json()["stacks"] == []


def test_wrong_settings_do_not_keep_anybody_from_looking(client, amazon, folder: Path):
    (folder / "run.env").write_text("DR_WORKERS=many\n")

    assert client.get("/api/spot").json()["stacks"] == []


def test_the_page_asks_with_the_price_before_it_starts_a_machine(served, visit, amazon):
    cloud = boto3.client("cloudformation", REGION)
    output = {"Bucket": {"Value": "models"}}
    topic = {"Topic": {"Type": "AWS::SNS::Topic"}}
    cloud.create_stack(
        StackName="racing",
        TemplateBody=json.dumps({"Resources": topic, "Outputs": output}),
        Tags=[{"Key": STACK_TAG, "Value": "racing"}, {"Key": KIND_TAG, "Value": "base"}],
    )
    page = visit(f"{served.url}/#/spot", width=390).page
    page.get_by_text("No machine costs money now.").wait_for()
    page.get_by_role("button", name="Start a spot training").click()
    page.get_by_label("Name").fill("run")
    page.get_by_role("button", name="Ask for the price").click()
    page.get_by_role("heading", name="Start run for up to 0.118 USD an hour?").wait_for()
    assert len(stacks.our_stacks(amazon)) == 1

    page.get_by_role("button", name="Start it").click()

    page.get_by_role("region", name="run", exact=True).wait_for()
    assert [each.name for each in stacks.our_stacks(amazon)] == ["racing", "run"]
    assert page.evaluate("document.documentElement.scrollWidth") == 390
