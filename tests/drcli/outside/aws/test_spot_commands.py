"""The commands of dr-spot, at moto in this process."""

import io
import json
import sys
from pathlib import Path

import boto3
import pytest

from drcli.base.errors import StorageError
from drcli.cli.app import main
from drcli.config.loading import load_settings
from drcli.model.model_store import ModelStore
from drcli.model.training_state import write_outcome
from drcli.outside.aws import stacks
from drcli.outside.aws.prices import ADDRESS_VARIABLE
from drcli.outside.aws.racer_files import environment, lay_out
from drcli.outside.aws.stack_logs import fetch_folder
from drcli.outside.aws.stacks import need_stack
from drcli.outside.aws.training_template import KIND_TAG, MODEL_TAG, STACK_TAG
from drcli.records.training_record import RunOutcome

UBUNTU = "ami-1e749f67"
"""An image that moto knows."""


@pytest.fixture
def spot(amazon, monkeypatch, tmp_path, capsys):
    """Runs a command; returns its code, its results and what it said."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    monkeypatch.setenv(ADDRESS_VARIABLE, "http://127.0.0.1:1/none.json")
    monkeypatch.setattr(stacks, "_POLL_S", 0.0)
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    for name in ("DR_DIR", "BUCKET", "DEEPRACER_INSTANCE_TYPE"):
        monkeypatch.delenv(name, raising=False)

    def run(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as end:
            main(["spot", *arguments])
        said = capsys.readouterr()
        return int(end.value.code or 0), said.out, said.err

    return run


@pytest.fixture
def training(amazon):
    """A stack of a training, without machines."""
    cloud = boto3.client("cloudformation", "us-east-1")
    topic = {"Topic": {"Type": "AWS::SNS::Topic"}}
    tags = {
        STACK_TAG: "run",
        KIND_TAG: "training",
        MODEL_TAG: "training/m",
        stacks.BUCKET_TAG: "models",
    }
    cloud.create_stack(
        StackName="run",
        TemplateBody=json.dumps({"Resources": topic}),
        Tags=[{"Key": key, "Value": value} for key, value in tags.items()],
    )
    yield "run"
    cloud.delete_stack(StackName="run")


@pytest.mark.filterwarnings("ignore:Tried to parse")  # moto makes no policies of buckets
def test_a_base_stack_is_made_listed_and_deleted_with_its_models(spot):
    asked = spot("create-base", "racing")
    made = spot("create-base", "racing", "--yes", "--json")
    bucket = json.loads(made[1])["bucket"]
    boto3.client("s3").put_object(Bucket=bucket, Key="m/model/.coach_checkpoint", Body=b"x")
    listed = json.loads(spot("list", "--json")[1])
    refused = spot("delete", "racing")
    deleted = spot("delete", "racing", "--yes")

    assert (asked[0], "Add -f" in asked[2]) == (1, True)
    assert [(each["stack"], each["kind"]) for each in listed["stacks"]] == [("racing", "base")]
    assert refused[0] == 1
    assert "among them the models m" in refused[2]
    assert (deleted[0], deleted[1]) == (0, "Removed racing with 1 object in its bucket.\n")
    names = [each["Name"] for each in boto3.client("s3").list_buckets()["Buckets"]]
    assert names == ["models"]
    assert spot("list")[1] == "There are no stacks in us-east-1.\n"


def test_a_base_stack_in_use_is_not_deleted(spot, training):
    cloud = boto3.client("cloudformation", "us-east-1")
    output = {"Bucket": {"Value": "models"}}
    body = {"Resources": {"Topic": {"Type": "AWS::SNS::Topic"}}, "Outputs": output}
    tags = {STACK_TAG: "shared", KIND_TAG: "base"}
    cloud.create_stack(
        StackName="shared",
        TemplateBody=json.dumps(body),
        Tags=[{"Key": key, "Value": value} for key, value in tags.items()],
    )

    code, _, said = spot("delete", "shared", "--yes")

    cloud.delete_stack(StackName="shared")
    assert code == 3
    assert "is used by the stacks run" in said


def test_stacks_of_others_are_neither_listed_nor_touched(spot):
    cloud = boto3.client("cloudformation", "us-east-1")
    body = json.dumps({"Resources": {"Topic": {"Type": "AWS::SNS::Topic"}}})
    cloud.create_stack(StackName="theirs", TemplateBody=body)

    assert json.loads(spot("list", "--json")[1])["stacks"] == []
    code, _, said = spot("delete", "theirs", "--yes")

    assert code == 3
    assert "was not made by drcli" in said
    assert cloud.describe_stacks(StackName="theirs")["Stacks"]
    cloud.delete_stack(StackName="theirs")


def test_no_model_is_said_to_stay_of_a_training_that_made_no_checkpoint(spot, training, amazon):
    amazon.bucket("models").put("training/m/reward_function.py", b"")

    code, said, _ = spot("delete", "run", "--yes")

    assert (code, said) == (0, "Removed run. There is no checkpoint of training/m.\n")


def test_a_training_is_listed_and_deleted_and_its_model_stays(spot, training, amazon):
    bucket = amazon.bucket("models")
    bucket.put("training/m/model/4_Step-40.ckpt.json", b"{}")
    bucket.put("spot/run/install.json", b"{}")

    listed = json.loads(spot("list", "--json")[1])["stacks"]
    code, said, _ = spot("delete", "run", "--yes")

    assert [(each["state"], each["checkpoint"]) for each in listed] == [
        ("waiting for a machine", "4_Step-40.ckpt")
    ]
    assert code == 0
    assert said == (
        "Removed run. The model training/m stays in the bucket. Its newest checkpoint, "
        "4_Step-40.ckpt, was not checked.\n"
    )
    assert [info.key for info in bucket.list("")] == ["training/m/model/4_Step-40.ckpt.json"]


def test_the_newest_log_is_shown(spot, training, amazon):
    assert spot("logs", "run")[0] == 1
    amazon.bucket("models").put("training/m/logs/trainer/trainer.log", b"one\ntwo\nthree\n")

    code, out, _ = spot("logs", "run", "train", "-n", "2")

    assert (code, out) == (0, "two\nthree\n")


def test_what_a_machine_has_printed_is_shown_without_the_bucket(spot, training, monkeypatch):
    without = spot("logs", "run", "console")
    ec2 = boto3.client("ec2", "us-east-1")
    tags = [{"ResourceType": "instance", "Tags": [{"Key": STACK_TAG, "Value": "run"}]}]
    made = ec2.run_instances(ImageId=UBUNTU, MinCount=1, MaxCount=1, TagSpecifications=tags)
    instance = made["Instances"][0]["InstanceId"]

    code, out, said = spot("logs", "run", "console", "-n", "2")

    ec2.terminate_instances(InstanceIds=[instance])
    assert (without[0], "has had no machine" in without[2]) == (1, True)
    assert code == 0, said
    assert instance in said
    assert len(out.splitlines()) == 2


def test_a_stack_that_has_not_trained_yet_is_not_to_be_started_here(spot, training, amazon):
    code, out, said = spot("status", "run")

    assert (code, "dr-start-training" in out) == (0, False), said
    assert "No machine of run has begun to train yet. It does so a few minutes after" in out


def test_a_log_that_is_not_there_is_answered_with_the_names_that_are(spot, training, amazon):
    none = spot("logs", "run", "boot")
    amazon.bucket("models").put("training/m/logs/sagemaker/trainer.log", b"one")
    code, _, said = spot("logs", "run", "boot")

    assert (none[0], "no log in the bucket yet" in none[2]) == (1, True)
    assert code == 1
    assert "no log with 'boot' in its name" in said
    assert "There are trainer.log." in said


@pytest.mark.parametrize("own", ["", "DR_CLOUD=local\nDR_LOCAL_S3_BUCKET=here\n"])
def test_a_training_is_watched_from_any_folder(spot, training, amazon, tmp_path, own):
    if own:
        (tmp_path / "run.env").write_text("DR_WORLD_NAME=bean\n")
        (tmp_path / "system.env").write_text(own)
    bucket = amazon.bucket("models")
    bucket.put("spot/run/files/run.env", b"DR_WORLD_NAME=reinvent_base\nDR_WORKERS=3\n")
    install = {"files": ["run.env"], "environment": {"DR_LOCAL_S3_PROFILE": "default"}}
    bucket.put("spot/run/install.json", json.dumps(install).encode())
    outcome = RunOutcome("s", "there", 1.0, 1.0, "finished", code=0, message="Over.", ended_at=2.0)
    write_outcome(ModelStore(bucket, "training/m"), outcome)

    code, out, said = spot("status", "run", "--json")

    assert code == 0, said
    report = json.loads(out)
    assert (report["bucket"], report["prefix"]) == ("models", "training/m")
    assert (report["state"], report["world"]) == ("finished", "reinvent_base")
    assert "dr-spot stop run" in said


@pytest.mark.parametrize(
    "install",
    [
        {"files": ["../../../out.env"], "environment": {}},
        {"files": ["/tmp/out.env"], "environment": {}},
        {"files": "run.env"},
        ["run.env"],
    ],
)
def test_what_others_wrote_into_the_bucket_changes_nothing_outside_its_folder(
    spot, training, amazon, tmp_path, install
):
    amazon.bucket("models").put("spot/run/install.json", json.dumps(install).encode())

    code, _, said = spot("status", "run")

    assert code == 4
    assert "spot/run/install.json is not what `dr-spot create` writes" in said
    assert not list(tmp_path.rglob("out.env"))


def test_variables_of_programs_are_not_taken_from_the_bucket(training, amazon, tmp_path):
    given = {
        "LD_PRELOAD": "a.so",
        "PYTHONPATH": ".",
        "AWS_PROFILE": "x",
        "PATH": "",
        "TEAM": "blue",
    }
    install = {"files": [], "environment": {**given, "DR_WORKERS": "3"}}
    amazon.bucket("models").put("spot/run/install.json", json.dumps(install).encode())
    (tmp_path / "worker-2.env").write_text("of an earlier stack")
    stack = need_stack(amazon, "run", "training")

    found = fetch_folder(amazon, stack, tmp_path, {"PATH": "/bin"})

    assert (found["PATH"], found["TEAM"], found["DR_WORKERS"]) == ("/bin", "blue", "3")
    assert not {"LD_PRELOAD", "PYTHONPATH", "AWS_PROFILE"} & set(found)
    assert not (tmp_path / "worker-2.env").exists()


def test_prices_that_no_region_tells_are_refused_with_the_remedy_of_their_cause(spot, monkeypatch):
    def refused(*_, **__):
        raise StorageError("No access keys were found.", remedy="Run `aws configure`.")

    monkeypatch.setattr("drcli.cli.commands.spot.find_types", refused)

    code, _, said = spot("prices")

    assert code == 4
    assert "Run `aws configure`." in said


def test_prices_are_compared(spot):
    code, out, said = spot("prices", "--type", "c7i.xlarge", "--json", "--sort_order", "spotprice")

    offers = json.loads(out)["offers"]
    assert code == 0
    assert {each["type"] for each in offers} == {"c7i.xlarge"}
    assert {each["workers"] for each in offers} == {2}
    assert "How often machines are interrupted is not known" in said


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (("prices", "--sort-order", "Colour"), 2, "'Colour' is not one of SpotPrice"),
        (("prices", "--interruption-filter", "7%"), 2, "'7%' is not one of <5%"),
        (("prices", "--interruption-filter", "<5%"), 4, "is not known"),
        (("prices", "--type", "c99.huge", "--region", "us-east-1"), 3, "c99.huge"),
        (("cost", "run"), 3, "There is no stack run in us-east-1"),
        (("stop", "my_run"), 3, "V-01"),
        (("ssh", "run"), 3, "There is no stack run"),
        (("add-access", "run", "8.8.8.8"), 3, "There is no stack run"),
        (("create", "run"), 3, "run.env"),
        (("create", "run", "--on-demand", "--fallback"), 2, "--on-demand uses no spot machine"),
        (("create", "run", "--files", "nowhere"), 3, "there is no run.env in this folder"),
    ],
)
def test_what_cannot_be_done_is_explained(spot, arguments, code, sentence):
    found, _, said = spot(*arguments)

    assert found == code, said
    assert sentence in said


def test_a_training_without_a_bucket_at_amazon_is_refused(spot, tmp_path):
    (tmp_path / "run.env").write_text("DR_WORLD_NAME=reinvent_base\n")

    code, _, said = spot("create", "run")

    assert code == 3
    assert "No bucket at Amazon is named" in said


def test_wrong_settings_do_not_keep_anybody_from_looking(spot, tmp_path):
    (tmp_path / "run.env").write_text("DR_WORKERS=many\n")

    assert spot("list")[0] == 0


def test_no_shell_without_a_machine(spot, training):
    code, _, said = spot("ssh", "run")

    assert code == 1
    assert "No machine of run is running" in said


def test_a_folder_of_the_old_kind_becomes_a_working_folder(tmp_path: Path):
    old, new = tmp_path / "custom-files", tmp_path / "new"
    (old / "examples").mkdir(parents=True)
    new.mkdir()
    (old / "tracks").mkdir()
    for name in (
        "run.env",
        "system.env",
        "worker-2.env",
        "curriculum.yaml",
        "reward_function.py",
        "README.md",
        "tracks/mine.npy",
    ):
        (old / name).write_text(name)

    lay_out(old, new)

    names = {path.relative_to(new).as_posix() for path in new.rglob("*") if path.is_file()}
    assert names == {
        "run.env",
        "system.env",
        "worker-2.env",
        "curriculum.yaml",
        "tracks/mine.npy",
        "custom_files/reward_function.py",
        "custom_files/README.md",
    }


def test_a_bucket_for_uploads_that_is_named_is_kept(tmp_path: Path):
    (tmp_path / "run.env").write_text("DR_WORLD_NAME=bean\nDR_UPLOAD_S3_BUCKET=away\n")
    settings = load_settings(tmp_path, environ={})

    ours = environment(settings, "models", "eu-west-1", "run", {})

    assert "DR_UPLOAD_S3_BUCKET" not in ours
    assert ours["DEEPRACER_REGION"] == "eu-west-1"
