"""A training is started on machines of Amazon, and removed, with moto in this process."""

import json
import math
import re
import time
from dataclasses import replace
from pathlib import Path

import boto3
import pytest

from drcli.base.errors import SettingsError, StorageError
from drcli.config.loading import load_settings
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_outcome, write_outcome
from drcli.outside.aws import creation, instance_types, stack_end, stack_report
from drcli.outside.aws.creation import StackOptions
from drcli.outside.aws.instance_types import InstanceType
from drcli.outside.aws.machine_marks import MachineMark, read_marks, stack_folder
from drcli.outside.aws.machines import cost_of, machines_of
from drcli.outside.aws.racer_files import InstallSource, environment, files_to_send
from drcli.outside.aws.stack_report import report_on
from drcli.outside.aws.stacks import add_access, find_stack, need_stack, our_stacks
from drcli.records.run_record import Lease
from drcli.records.training_record import RunOutcome
from drcli.transfer.transfer_buckets import parse_url, source_bucket

WHEEL = InstallSource("", "drcli-9-py3-none-any.whl", b"a wheel")
OPTIONS = StackOptions("run", "models", types=("c7i.xlarge", "c7g.xlarge"), image="ami-1e749f67")
RUN_ENV = "DR_WORLD_NAME=reinvent_base\nDR_LOCAL_S3_MODEL_PREFIX=training/race/m-1\n"


def prepare(amazon, settings, options: StackOptions, source: InstallSource, **variables: str):
    """The plan of `dr-spot create`, after its checks."""
    sent = files_to_send(settings)
    given = environment(settings, options.bucket, amazon.region, options.stack, variables)
    return creation.prepare(amazon, settings, options, source, sent, given)


@pytest.fixture
def settings(tmp_path: Path):
    (tmp_path / "run.env").write_text(RUN_ENV)
    (tmp_path / "system.env").write_text("DR_WORKERS=1\n")
    return load_settings(tmp_path, environ={})


@pytest.fixture(scope="module")
def one_stack(shared_amazon, tmp_path_factory):
    """A stack that runs; the tests leave it as it is."""
    folder = tmp_path_factory.mktemp("racer")
    (folder / "run.env").write_text(RUN_ENV)
    options = replace(OPTIONS, types=("c7i.xlarge",))
    plan = prepare(shared_amazon, load_settings(folder, environ={}), options, WHEEL)
    creation.carry_out(shared_amazon, plan)
    return need_stack(shared_amazon, "run")


@pytest.fixture
def stack(amazon, one_stack):
    """That stack, with an empty bucket."""
    return one_stack


@pytest.fixture
def options() -> StackOptions:
    """For another stack."""
    return replace(OPTIONS, stack="other", types=("c7i.xlarge", "m7i.xlarge"))


def write_mark(amazon, stack, state: str, instance: str) -> None:
    mark = MachineMark(
        instance, "c7i.xlarge", "us-east-1a", "spot", 0.07, time.time(), time.time(), state
    )
    key = f"{stack_folder(stack.name)}machines/{mark.instance}.json"
    amazon.bucket("models").put(key, mark.encode())


@pytest.mark.nightly
def test_a_stack_is_made_and_removed_and_only_the_model_stays(amazon, settings, options):
    plan = prepare(amazon, settings, options, WHEEL)
    report = creation.carry_out(amazon, plan, pause=lambda seconds: None)
    stack, bucket = need_stack(amazon, "other"), amazon.bucket("models")
    ours = machines_of(amazon, stack, [])
    files = {info.key for info in bucket.list("")}
    install = json.loads(bucket.get("spot/other/install.json"))
    bucket.put("training/race/m-1/model/x", b"a model")

    done = stack_end.remove_training(amazon, stack, "", pause=lambda seconds: None)

    assert report.stack == "other"
    assert [machine.state for machine in ours] == ["running"]
    assert files == {
        f"spot/other/{name}"
        for name in ("install.json", WHEEL.wheel, "files/run.env", "files/system.env")
    }
    assert install["sha256"] == WHEEL.sha256
    assert install["environment"]["DR_CLOUD"] == "aws"
    assert install["environment"]["DR_UPLOAD_S3_BUCKET"] == "models"
    assert (stack.kind, stack.model, stack.bucket) == ("training", "training/race/m-1", "models")
    assert stack.ends == pytest.approx(time.time() + 12 * 3600, abs=300)
    assert find_stack(amazon, "other") is None
    assert [info.key for info in bucket.list("")] == ["training/race/m-1/model/x"]
    assert {each.state for each in machines_of(amazon, stack, [])} <= {"terminated"}
    assert not any(name in str(boto3.client("iam").list_roles()) for name in ("other-Role",))
    templates = boto3.client("ec2", "us-east-1").describe_launch_templates()["LaunchTemplates"]
    assert not [each for each in templates if "other" in each["LaunchTemplateName"]]
    assert done.objects == 4


def test_nothing_is_made_while_it_is_planned(amazon, settings, options):
    prepare(amazon, settings, options, WHEEL)

    assert find_stack(amazon, "other") is None
    assert amazon.bucket("models").list("") == []


def test_a_name_that_is_taken_is_refused(amazon, settings, options, stack):
    assert [each.name for each in our_stacks(amazon)] == ["run"]
    with pytest.raises(SettingsError, match="There is a stack run"):
        prepare(amazon, settings, replace(options, stack="run"), WHEEL)


@pytest.mark.parametrize("name", ["", "1-run", "my_run", "a" * 65, "läufer"])
def test_names_that_amazon_does_not_take_are_refused(amazon, name):
    with pytest.raises(SettingsError, match="V-01"):
        find_stack(amazon, name)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"ttl_minutes": 5}, "5 minutes"),
        ({"ttl_minutes": 20_000}, "20000 minutes"),
        ({"most_usd": 0.0}, "highest price"),
        ({"most_usd": float("nan")}, "highest price"),
        ({"bucket": "elsewhere"}, "no bucket elsewhere"),
        ({"types": ("c99.huge",)}, "c99.huge"),
        ({"types": ("t3.nano",)}, "too little memory"),
        ({"subnets": ("subnet-0",)}, "network"),
        ({"types": ("c7g.xlarge",)}, "is for x86_64, not for arm64"),
    ],
)
def test_options_that_cannot_be_met_are_refused(amazon, settings, options, changes, sentence):
    with pytest.raises(SettingsError, match=sentence):
        prepare(amazon, settings, replace(options, **changes), WHEEL)


def test_a_price_that_no_machine_has_is_refused(amazon, settings, options):
    with pytest.raises(StorageError, match="No spot machine costs at most"):
        prepare(amazon, settings, replace(options, most_usd=0.000001), WHEEL)


def test_a_model_that_another_machine_trains_is_refused(amazon, settings, options):
    owner = Lease("s", "elsewhere", 1, time.time(), machine="other")
    lease.write_lease(ModelStore(amazon.bucket("models"), settings.model_prefix), owner)

    with pytest.raises(SettingsError, match="is being trained by process 1 on elsewhere"):
        prepare(amazon, settings, options, WHEEL)


def test_a_prefix_with_other_objects_is_refused(amazon, settings, options):
    amazon.bucket("models").put("training/race/m-1/notes.txt", b"")

    with pytest.raises(SettingsError, match="no checkpoint"):
        prepare(amazon, settings, options, WHEEL)


def test_a_longer_name_of_a_model_is_not_in_the_way(amazon, settings, options):
    amazon.bucket("models").put("training/race/m-10/notes.txt", b"")

    assert prepare(amazon, settings, options, WHEEL).resumes == ""


def test_a_training_that_was_stopped_is_continued(amazon, settings, options, stack, monkeypatch):
    bucket, prefix = amazon.bucket("models"), settings.model_prefix
    bucket.put(keys.checkpoint_record(prefix, "3_Step-30.ckpt"), b"{}")
    stopped = RunOutcome("one", "host", 1.0, 2.0, "stopped", code=143, stays_ended=True)
    write_outcome(ModelStore(bucket, prefix), stopped)

    plan = prepare(amazon, settings, options, WHEEL)
    monkeypatch.setattr(creation, "create_stack", lambda *args, **named: stack)
    creation.carry_out(amazon, plan)

    assert any("it is continued now" in note for note in plan.notes)
    assert read_outcome(ModelStore(bucket, prefix)) == replace(stopped, stays_ended=False)


def test_a_stack_that_cannot_be_made_leaves_no_files(amazon, settings, options, monkeypatch):
    plan = prepare(amazon, settings, options, WHEEL)

    def fail(*args: object, **named: object) -> None:
        raise StorageError("No.", remedy="")

    monkeypatch.setattr(creation, "create_stack", fail)
    with pytest.raises(StorageError):
        creation.carry_out(amazon, plan)

    assert amazon.bucket("models").list("spot/") == []


def test_both_architectures_have_their_own_image(amazon, monkeypatch):
    base = "/aws/service/ami-amazon-linux-latest/al2023-ami-kernel-default-"
    names = {"x86_64": base + "x86_64", "arm64": base + "arm64"}
    monkeypatch.setattr(instance_types, "IMAGE_NAMES", names)

    found = instance_types.find_images(amazon, ["x86_64", "arm64", "x86_64"], "")

    assert set(found) == {"x86_64", "arm64"}
    assert found["x86_64"].id != found["arm64"].id


def test_an_image_that_does_not_exist_is_refused(amazon):
    with pytest.raises(StorageError, match="no image ami-00000000"):
        instance_types.find_images(amazon, ["x86_64"], "ami-00000000")


def test_files_and_tracks_of_an_experiment_are_sent(amazon, tmp_path, options):
    (tmp_path / "run.env").write_text("DR_WORLD_NAME=reinvent_base\n")
    (tmp_path / "system.env").write_text("DR_EXPERIMENT_NAME=fast\n")
    own = tmp_path / "experiments" / "fast"
    own.mkdir(parents=True)
    (own / "run.env").write_text(RUN_ENV)
    (tmp_path / "notes.env").write_text("SECRET=1\n")

    plan = prepare(amazon, load_settings(tmp_path, environ={}), options, WHEEL)

    assert sorted(plan.files) == ["experiments/fast/run.env", "run.env", "system.env"]


def test_routes_and_the_files_of_stages_are_sent_and_what_is_outside_is_refused(tmp_path: Path):
    elsewhere = tmp_path / "routes"
    racer = tmp_path / "racer"
    for folder in (elsewhere, racer / "custom_files", racer / "lists"):
        folder.mkdir(parents=True)
    for path in (
        elsewhere / "mine.npy",
        elsewhere / "other.npy",
        racer / "lists" / "far.csv",
        racer / "curriculum.yaml",
        racer / "custom_files" / "reward_function.py",
        racer / "custom_files" / "notes.txt",
    ):
        path.write_bytes(b"x")
    (racer / "run.env").write_text(
        "DR_WORLD_NAME=mine_cw\nDR_TRAIN_WORLDS=lists/far.csv,reinvent_base\n"
    )
    (racer / "system.env").write_text(f"DR_TRACKS_DIR={elsewhere}\n")
    settings = load_settings(racer, environ={})

    sent = files_to_send(settings, further=[racer / "curriculum.yaml"])

    assert sorted(sent) == [
        "curriculum.yaml",
        "custom_files/reward_function.py",
        "lists/far.csv",
        "run.env",
        "system.env",
        "tracks/mine.npy",
    ]
    given = environment(settings, "models", "us-east-1", "run", {})
    assert (given["DR_TRACKS_DIR"], given["DR_TRACKS_FETCH"]) == ("tracks", "always")
    for outside in (elsewhere / "other.npy", racer / ".." / "routes" / "other.npy"):
        with pytest.raises(SettingsError, match="is outside of"):
            files_to_send(settings, further=[outside])


def test_settings_of_the_shell_count_on_the_machine_but_its_passwords_stay(tmp_path: Path):
    (tmp_path / "run.env").write_text(
        "DR_WORLD_NAME=bean\nDR_LOCAL_S3_MODEL_PREFIX=$TEAM/first\nDR_TRACKS_FETCH=never\n"
        "# $AWS_PROFILE\n"
    )
    shell = {
        "TEAM": "blue",
        "HOME": "/home/racer",
        "DR_WORKERS": "3",
        "DR_LOCAL_S3_BUCKET": "here",
        "DR_DROA_PASSWORD": "a-password",
        "AWS_SECRET_ACCESS_KEY": "a-key",
        "AWS_PROFILE": "mine",
        "LANG": "C",
    }
    settings = load_settings(tmp_path, environ=shell)

    given = environment(settings, "models", "us-east-1", "run", shell)

    assert (given["TEAM"], given["DR_WORKERS"]) == ("blue", "3")
    assert given["DR_LOCAL_S3_BUCKET"] == given["DR_UPLOAD_S3_BUCKET"] == "models"
    kept = {"HOME", "LANG", "DR_DROA_PASSWORD", "AWS_SECRET_ACCESS_KEY", "AWS_PROFILE"}
    assert not kept & set(given)
    assert "DR_TRACKS_FETCH" not in given


def test_a_report_shows_machine_state_and_cost(amazon, stack):
    instance = machines_of(amazon, stack, [])[0].instance
    write_mark(amazon, stack, "failed", instance)

    report = report_on(amazon, stack)

    assert report.state == "failed"
    assert report.machines[0].said == "failed"
    assert report.usd is not None


def test_a_stack_without_a_word_of_its_machine_is_booting(amazon, stack, monkeypatch):
    monkeypatch.setattr(stack_report, "SILENT_S", math.inf)
    assert report_on(amazon, stack).state == "booting"
    assert report_on(amazon, stack).reason == ""


def test_a_machine_that_never_reached_the_bucket_is_told_with_where_to_look(
    amazon, stack, monkeypatch
):
    monkeypatch.setattr(stack_report, "SILENT_S", 0.0)

    reason = report_on(amazon, stack).reason

    assert "has not reached the bucket in" in reason
    assert f"`dr-spot logs {stack.name} console`" in reason


def test_a_machine_that_amazon_has_forgotten_still_costs(amazon, stack):
    write_mark(amazon, stack, "interrupted", "i-gone")

    found = machines_of(amazon, stack, read_marks(amazon.bucket("models"), "run"))

    assert [each.state for each in found if each.instance == "i-gone"] == ["gone"]
    assert len(cost_of(amazon, "run", found).machines) == 2


def test_a_stop_waits_for_the_machine_and_checks_the_model(amazon, stack):
    instance = machines_of(amazon, stack, [])[0].instance
    write_mark(amazon, stack, "training", instance)
    owner = Lease("s", "machine", 1, time.time(), machine="other")
    lease.write_lease(ModelStore(amazon.bucket("models"), stack.model), owner)
    waits: list[float] = []

    def end_meanwhile(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) == 2:
            write_mark(amazon, stack, "stopped", instance)

    stack_end.stop_training_there(amazon, stack, patience_s=60, pause=end_meanwhile)

    assert len(waits) == 2
    with pytest.raises(StorageError, match="still being trained"):
        stack_end.verified_checkpoint(amazon, stack)
    lease.release(ModelStore(amazon.bucket("models"), stack.model), "s")
    assert stack_end.verified_checkpoint(amazon, stack) == ""


def test_a_stop_that_takes_too_long_deletes_nothing(amazon, stack):
    instance = machines_of(amazon, stack, [])[0].instance
    write_mark(amazon, stack, "training", instance)
    owner = Lease("s", "machine", 1, time.time(), machine="other")
    lease.write_lease(ModelStore(amazon.bucket("models"), stack.model), owner)
    now = [0.0]

    def later(seconds: float) -> None:
        now[0] += seconds

    with pytest.raises(StorageError, match="has not stopped within 60 s"):
        stack_end.stop_training_there(
            amazon, stack, patience_s=60, pause=later, clock=lambda: now[0]
        )

    assert find_stack(amazon, "run") is not None


def test_a_damaged_model_keeps_its_stack(amazon, stack):
    bucket = amazon.bucket("models")
    bucket.put(keys.checkpoint_record(stack.model, "3_Step-30.ckpt"), b"{}")

    with pytest.raises(StorageError):
        stack_end.verified_checkpoint(amazon, stack)


def test_a_checkpoint_of_the_reference_is_not_said_to_be_whole(amazon, stack, monkeypatch):
    monkeypatch.setattr(stack_end, "delete_stack", lambda *_: None)
    sizes = []
    groups = amazon.client("autoscaling")
    monkeypatch.setattr(groups, "update_auto_scaling_group", lambda **size: sizes.append(size))
    bucket = amazon.bucket("models")
    for end in (".index", ".data-00000-of-00001", ".meta"):
        bucket.put(keys.checkpoint_part(stack.model, "3_Step-30.ckpt", end), b"")

    report = stack_end.remove_training(amazon, stack, stack_end.verified_checkpoint(amazon, stack))

    ended = {"MinSize": 0, "DesiredCapacity": 0}
    assert sizes == [{"AutoScalingGroupName": group, **ended} for group in stack.groups]
    assert (report.checkpoint, report.whole) == ("3_Step-30.ckpt", False)
    assert "checkpoint, 3_Step-30.ckpt, was not checked." in str(report)


def test_a_training_that_ended_before_its_first_checkpoint_may_begin_anew(
    amazon, settings, options
):
    bucket, prefix = amazon.bucket("models"), settings.model_prefix
    bucket.put(keys.training_start(prefix), b"{}")
    bucket.put(f"{keys.folder(prefix)}logs/sagemaker/trainer.log", b"It ended.")

    plan = prepare(amazon, settings, options, WHEEL)

    assert not plan.resumes
    assert any("ended before its first checkpoint" in note for note in plan.notes)


def test_a_policy_in_the_bucket_gets_the_command_that_makes_it_a_model_there(
    amazon, settings, options
):
    amazon.bucket("models").put(f"{settings.model_prefix}/model_3.pb", b"graph")

    with pytest.raises(SettingsError, match="no checkpoint to resume from") as refused:
        prepare(amazon, settings, options, WHEEL)

    [command] = re.findall("`(.*)`", refused.value.remedy)
    *variables, program, flag, url, option, name = command.split()
    assert (program, flag, option) == ("dr-import", "-L", "-t")
    assert name == f"{settings.model_prefix}-imported"
    environ = dict(each.split("=", 1) for each in variables)
    there = load_settings(settings.directory, environ=environ)
    bucket, prefix = parse_url(url)
    source = source_bucket(there.transfer, bucket, local=True, patience_s=1.0)
    assert [info.key for info in source.list(keys.folder(prefix))] == [
        f"{settings.model_prefix}/model_3.pb"
    ]
    assert there.storage.bucket == "models"  # the model is written there too


def test_one_address_is_let_in(amazon, stack):
    assert add_access(amazon, stack, "8.8.8.8") == "8.8.8.8/32"
    assert add_access(amazon, stack, "8.8.8.8/32") == "8.8.8.8/32"

    group = boto3.client("ec2", "us-east-1").describe_security_groups(
        GroupIds=[stack.outputs["Firewall"]]
    )["SecurityGroups"][0]
    rules = [(rule["FromPort"], rule["ToPort"]) for rule in group["IpPermissions"]]
    assert rules == [(22, 22)]


@pytest.mark.parametrize("address", ["0.0.0.0", "0.0.0.0/0", "8.8.8.0/24", "10.0.0.1", "me"])
def test_more_than_one_address_is_refused(amazon, stack, address):
    with pytest.raises(SettingsError):
        add_access(amazon, stack, address)


def test_workers_are_counted_by_processor_threads():
    assert [InstanceType("x", "x86_64", n, 4096).workers for n in (1, 2, 4, 8)] == [1, 1, 2, 4]
