"""The boot program, run for real in a fake root, with moto for Amazon."""

import json
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from botocore.auth import S3SigV4Auth
from botocore.awsrequest import AWSRequest
from botocore.credentials import Credentials

from drcli.base.errors import EndWorkFailed
from drcli.checks.explain.explain_texts import EXIT_CODES
from drcli.outside.aws import boot
from drcli.outside.aws.machine_marks import MachineMark
from drcli.outside.aws.racer_files import InstallSource
from fake_amazon import client, machine_facts, make_group
from fake_machine import FakeMachine

pytestmark = pytest.mark.nightly

KEYS = {"AccessKeyId": "ASIAMACHINE", "SecretAccessKey": "a-secret", "Token": "a-token"}
WHEEL = InstallSource("", "drcli-9+local-py3-none-any.whl", b"a wheel")


class Cloud:
    """Bucket, topic and group of a stack."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.s3, self.group = client("s3", endpoint), client("autoscaling", endpoint)
        self.s3.create_bucket(Bucket="models")
        sns, sqs = client("sns", endpoint), client("sqs", endpoint)
        self.topic = sns.create_topic(Name="races")["TopicArn"]
        self.sqs, self.queue = sqs, sqs.create_queue(QueueName="read")["QueueUrl"]
        arn = sqs.get_queue_attributes(QueueUrl=self.queue, AttributeNames=["QueueArn"])
        sns.subscribe(TopicArn=self.topic, Protocol="sqs", Endpoint=arn["Attributes"]["QueueArn"])
        make_group(self.group)

    def restore(self) -> None:
        """Forget what a test has done; to make all of it again takes seconds."""
        found = self.s3.list_objects_v2(Bucket="models").get("Contents", [])
        for entry in found:
            self.s3.delete_object(Bucket="models", Key=entry["Key"])
        self.messages()
        if not self.wanted:
            self.group.set_desired_capacity(AutoScalingGroupName="run", DesiredCapacity=1)

    def put(self, name: str, data: bytes) -> None:
        self.s3.put_object(Bucket="models", Key=f"spot/run/{name}", Body=data)

    def get(self, name: str) -> bytes:
        return self.s3.get_object(Bucket="models", Key=f"spot/run/{name}")["Body"].read()

    def mark(self, instance: str = "i-0123456789abcdef0") -> MachineMark:
        return MachineMark.decode(self.get(f"machines/{instance}.json"))

    @property
    def wanted(self) -> int:
        """How many machines the group wants."""
        return self.group.describe_auto_scaling_groups()["AutoScalingGroups"][0]["DesiredCapacity"]

    def messages(self) -> list[str]:
        """Subjects of the messages."""
        found = self.sqs.receive_message(QueueUrl=self.queue, MaxNumberOfMessages=10)
        messages = found.get("Messages", [])
        for each in messages:
            self.sqs.delete_message(QueueUrl=self.queue, ReceiptHandle=each["ReceiptHandle"])
        return [json.loads(each["Body"])["Subject"] for each in messages]


@pytest.fixture(scope="module")
def amazon_server(moto_address: str) -> Cloud:
    return Cloud(moto_address)


@pytest.fixture
def cloud(amazon_server: Cloud) -> Cloud:
    made = amazon_server
    made.restore()
    plan = {
        "source": "",
        "wheel": WHEEL.wheel,
        "sha256": WHEEL.sha256,
        "torch": "torch==2.13.0",
        "packages": ["python3-venv"],
        "files": ["run.env", "experiments/a/run.env", "tracks/mine.npy"],
        "environment": {"DR_CLOUD": "aws", "DR_LOCAL_S3_BUCKET": "models"},
        "given": [],
        "on_demand_usd": {"c7i.xlarge": 0.1785},
        "continues": True,
    }
    made.put("install.json", json.dumps(plan).encode())
    made.put(WHEEL.wheel, WHEEL.data)
    made.put("files/run.env", b"DR_WORLD_NAME=reinvent_base\n")
    made.put("files/experiments/a/run.env", b"\n")
    made.put("files/tracks/mine.npy", b"\x93NUMPY\xff")
    return made


@pytest.fixture
def machine(cloud: Cloud, tmp_path: Path) -> Iterator[Callable[..., FakeMachine]]:
    """Makes machines of the stack `run`."""
    made: list[FakeMachine] = []

    def make(**changes: Any) -> FakeMachine:
        facts = machine_facts(cloud.topic, float(int(time.time()) + 7200)) | changes
        keys = changes.pop("keys", KEYS)
        name = f"machine-{len(made)}"
        made.append(FakeMachine(tmp_path / name, facts, cloud.endpoint, keys))
        return made[-1]

    yield make
    for each in made:
        each.close()


def change_plan(cloud: Cloud, **changes: Any) -> None:
    plan = {**json.loads(cloud.get("install.json")), **changes}
    cloud.put("install.json", json.dumps(plan).encode())


def test_a_machine_installs_the_wheel_and_starts_the_training(cloud, machine):
    ours = machine()

    done = ours.boot()

    assert done.returncode == 0, done.stdout
    assert cloud.mark().state == "training"
    assert (cloud.mark().type, cloud.mark().market) == ("c7i.xlarge", "spot")
    pip = [call for call in ours.calls if call.startswith("pip")]
    assert [line.split()[-1].rpartition("/")[2] for line in pip] == ["torch==2.13.0", WHEEL.wheel]
    assert ours.file("/opt/drcli/racer/run.env") == "DR_WORLD_NAME=reinvent_base\n"
    assert (ours.root / "opt/drcli/racer/tracks/mine.npy").read_bytes() == b"\x93NUMPY\xff"
    variables = dict(x.split("=", 1) for x in ours.file("/opt/drcli/environment").split())
    assert variables["DR_CLOUD"] == "aws"
    assert variables["MY_SNS_TOPIC"] == cloud.topic
    assert ours.calls[-1] == "systemctl enable --now --no-block drcli-training.service"
    assert b"attempt" not in cloud.get("logs/i-0123456789abcdef0-boot.log")


def test_no_key_of_the_role_is_in_logs_or_files(cloud, machine):
    ours = machine()

    done = ours.boot()

    everything = (
        done.stdout
        + "".join(ours.calls)
        + cloud.get("logs/" + ours.instance + "-boot.log").decode()
    )
    everything += "".join(
        path.read_text(errors="replace") for path in ours.root.rglob("*") if path.is_file()
    )
    assert KEYS["SecretAccessKey"] not in everything
    assert KEYS["Token"] not in everything


def test_the_service_trains_and_the_timer_stops_it_before_the_end(machine):
    ours = machine(ends=1_800_000_000.0)

    ours.boot()

    service = ours.unit("drcli-training.service")["Service"]
    assert service["ExecStart"].endswith("dr-start-training --resume-or-start --foreground")
    assert service["User"] == "drcli"
    assert service["RestartForceExitStatus"] == "75"
    timer = ours.unit("drcli-end.timer")["Timer"]
    assert timer["OnCalendar"] == "2027-01-15 07:55:00 UTC"
    assert ours.unit("drcli-end.service")["Service"]["ExecStart"].endswith("dr-stop-training")


def test_a_machine_without_a_limit_has_no_timer(machine):
    ours = machine(ends=0.0)

    ours.boot()

    assert not (ours.root / "etc/systemd/system/drcli-end.timer").exists()


def test_the_price_is_only_set_where_the_racer_has_not(cloud, machine):
    change_plan(cloud, given=["DR_SPOT_PRICE"])
    ours = machine()

    ours.boot()

    assert "DR_SPOT_PRICE" not in ours.file("/opt/drcli/environment")


def test_an_ordinary_machine_knows_its_price(cloud, machine):
    ours = machine()
    ours.metadata.describe({"instance-life-cycle": "on-demand"})

    ours.boot()

    assert cloud.mark().price == 0.1785
    assert "DR_SPOT_PRICE=0.1785" in ours.file("/opt/drcli/environment")


def test_a_boot_that_fails_is_tried_again_then_reported_and_the_group_ends(cloud, machine):
    ours = machine()
    (ours.root / "no-packages").touch()

    done = ours.boot()

    assert done.returncode == 1
    assert sum("update -q" in call for call in ours.calls) == 3
    assert cloud.mark().state == "failed"
    assert "apt-get" in cloud.mark().text or "env" in cloud.mark().text
    assert b"attempt 3 of 3 failed" in cloud.get(f"logs/{ours.instance}-boot.log")
    assert cloud.wanted == 0
    assert cloud.messages() == ["Training failed: run"]


def test_a_machine_that_cannot_reach_amazon_leaves_as_soon_as_it_can(machine, monkeypatch):
    ours = machine()
    refused = [boot.BootFailed("no network"), boot.BootFailed("no network"), None]
    paused, left = [], []

    def leave(_machine, state, text):
        left.append((state, text))
        if error := refused.pop(0):
            raise error

    monkeypatch.setattr(boot, "ROOT", str(ours.root))
    monkeypatch.setattr(boot, "_metadata", ours.metadata.address)
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    monkeypatch.setattr(boot, "pause", paused.append)
    monkeypatch.setattr(boot.Machine, "leave", leave)

    assert boot.start() == 1

    assert len(set(left)) == 1
    assert left[0][0] == "failed"
    assert "s3 cannot be reached" in left[0][1]
    assert paused[-2:] == [boot.LEAVE_PAUSE_S] * 2


def test_the_message_about_an_end_is_sent_once_when_the_network_is_back(machine, monkeypatch):
    ours = machine()
    failures = [boot.BootFailed("no network")] * 4 + [json.JSONDecodeError("no keys", "", 0)]
    asked, paused = [], []

    def call(_machine, service, *_, **__):
        if failures:
            raise failures.pop(0)
        asked.append(service)
        return b""

    monkeypatch.setattr(boot, "ROOT", str(ours.root))
    monkeypatch.setattr(boot, "_metadata", ours.metadata.address)
    monkeypatch.setattr(boot, "pause", paused.append)
    ours_now = boot.Machine()
    monkeypatch.setattr(boot.Machine, "call", call)

    boot.leave_at_last(ours_now, "failed", "The machine could not be set up.")

    assert paused == [boot.LEAVE_PAUSE_S] * 2
    assert asked == ["s3", "s3", "sns", "autoscaling"]


def test_a_wheel_that_was_replaced_is_not_installed(cloud, machine):
    cloud.put(WHEEL.wheel, b"another wheel")
    ours = machine()

    ours.boot()

    assert not any(WHEEL.wheel in call for call in ours.calls)
    assert "damaged or was replaced" in cloud.mark().text


def test_a_boot_without_its_plan_fails_and_says_so(cloud, machine):
    cloud.s3.delete_object(Bucket="models", Key="spot/run/install.json")
    ours = machine()

    assert ours.boot().returncode == 1
    assert "install.json" in cloud.mark().text
    assert cloud.wanted == 0


def test_a_machine_that_boots_after_the_end_leaves(cloud, machine):
    ours = machine(ends=time.time() + 60)

    ours.boot()

    assert cloud.mark().state == "stopped"
    assert cloud.wanted == 0
    assert not any(call.startswith("pip") for call in ours.calls)


@pytest.mark.parametrize(
    ("code", "state"), [(0, "finished"), (143, "stopped"), (3, "failed"), (6, "failed")]
)
def test_the_machine_leaves_when_the_training_has_ended(cloud, machine, code, state):
    ours = machine()
    ours.boot()

    again = ours.after_service(code)

    assert not again
    assert cloud.mark().state == state
    assert cloud.wanted == 0
    assert cloud.messages() == [f"Training {state}: run"]


def test_a_complete_training_is_finished_although_work_at_its_end_failed(cloud, machine):
    ours = machine()
    ours.boot()
    runs = ours.root / "opt/drcli/racer/data/runs"
    for name, record in {
        "0": '{"exit_code": null, "message": "", "remedy": ""}',
        "1": "{",
        "2": '{"exit_code": 10, "message": "Over. The upload failed.", "remedy": "Repeat it."}',
    }.items():
        (runs / name).mkdir(parents=True)
        (runs / name / "run.json").write_text(record)

    again = ours.after_service(boot.END_WORK_FAILED)

    assert (again, cloud.wanted, cloud.mark().state) == (False, 0, "finished")
    assert cloud.messages() == ["Training finished: run"]
    assert cloud.mark().text.endswith("Over. The upload failed. Repeat it.")


@pytest.mark.parametrize("code", [0, 143])
def test_how_a_training_ended_as_wanted_reaches_the_racer(cloud, machine, code):
    ours = machine()
    ours.boot()
    record = {"exit_code": code, "message": "Stopped on request.", "remedy": "Continue."}
    (ours.root / "opt/drcli/racer/data/runs/0").mkdir(parents=True)
    (ours.root / "opt/drcli/racer/data/runs/0/run.json").write_text(json.dumps(record))

    ours.after_service(code)

    said = f"The training ended with code {code}. Stopped on request. Continue."
    assert cloud.mark().text == said


def test_the_boot_program_knows_the_exit_codes_of_the_command():
    assert EndWorkFailed.code == boot.END_WORK_FAILED
    assert set(boot.FINAL) <= set(EXIT_CODES)


@pytest.mark.parametrize("code", [2, 3, 7, 1, 4, 5, 75])
def test_what_a_failed_training_printed_reaches_the_racer(cloud, machine, code):
    ours = machine()
    ours.boot()
    ours.journal.write_text(
        "Downloading ...\nError: run.env line 2: Oval is not a known track.\n  Try: Correct it.\n"
    )

    ours.after_service(code)

    sentence = "Error: run.env line 2: Oval is not a known track. Try: Correct it."
    assert f"ended with code {code}. {sentence}" in cloud.mark().text
    assert sentence.encode() in cloud.get(f"logs/{ours.instance}-boot.log")


def test_a_training_that_was_killed_is_said_to_be_with_its_last_lines(cloud, machine):
    ours = machine()
    ours.boot()
    ours.journal.write_text("".join(f"Iteration {k}\n" for k in range(9)))

    ours.after_service(-9, SERVICE_RESULT="oom-kill")

    said = "was ended by signal KILL because the memory of the machine ran out."
    assert cloud.mark().text.startswith(f"The training {said} Iteration 6 Iteration 7 Iteration 8")


def test_lines_of_a_training_that_was_interrupted_are_no_reason(cloud, machine):
    ours = machine()
    ours.boot()
    ours.journal.write_text("Interrupted. Continue with ...\n")
    ours.metadata.interrupt()

    ours.after_service(75)

    assert cloud.mark().text == "The training ended with code 75. Reason: spot notice."


def test_a_full_disk_keeps_nobody_from_learning_why(cloud, machine):
    ours = machine()
    ours.boot()
    (ours.root / "var/log/drcli-boot.log").unlink()
    (ours.root / "var/log/drcli-boot.log").mkdir()  # so nothing can be written there
    ours.journal.write_text("Error: data/logs: there is no room on the disk.\n")

    done = ours.boot("ended", EXIT_CODE="exited", EXIT_STATUS="3")

    assert "no room on the disk" in done.stdout, "the console of the machine has it"
    assert "no room on the disk" in cloud.mark().text
    assert b"no room on the disk" in cloud.get(f"logs/{ours.instance}-boot.log")
    assert cloud.wanted == 0


def test_without_the_bucket_the_console_has_it_and_the_next_end_tries_again(cloud, machine):
    ours = machine()
    ours.boot()
    ours.journal.write_text("Error: the bucket does not answer.\n")

    done = ours.boot(
        "ended", EXIT_CODE="exited", EXIT_STATUS="3", AWS_ENDPOINT_URL="http://127.0.0.1:1"
    )

    assert done.returncode == 0
    assert "Error: the bucket does not answer." in done.stdout
    assert not (ours.root / "run/drcli/leaving").exists()
    assert not ours.after_service(3)
    assert cloud.wanted == 0


def test_variables_reach_the_training_as_they_are(cloud, machine):
    value = 'a "b" $c `d` \\e # f'
    change_plan(cloud, environment={"DR_ON_END": value, "DR_CLOUD": "aws"})
    ours = machine()
    ours.boot()
    file = ours.root / "opt/drcli/environment"

    shell = subprocess.run(
        ["sh", "-c", f'set -a; . {file}; printf %s "$DR_ON_END"'],
        capture_output=True,
        text=True,
        check=True,
    )

    assert shell.stdout == value


@pytest.mark.parametrize("code", [75, 9, 8])
def test_the_training_starts_again_when_it_waits_for_another(cloud, machine, code):
    ours = machine()
    ours.boot()

    assert ours.after_service(code)
    assert cloud.mark().state == "waiting"
    assert cloud.wanted == 1


def test_a_machine_with_a_notice_does_not_take_the_model_back(cloud, machine):
    ours = machine()
    ours.boot()
    ours.metadata.interrupt()

    assert not ours.after_service(75)
    assert cloud.mark().state == "interrupted"
    assert cloud.wanted == 1, "the group replaces the machine"


def test_a_run_that_must_not_continue_ends_with_its_machine(cloud, machine):
    change_plan(cloud, continues=False)
    ours = machine()
    ours.boot()
    ours.metadata.interrupt()

    ours.after_service(75)

    assert cloud.wanted == 0


def test_five_failures_within_an_hour_end_the_machine(cloud, machine):
    ours = machine()
    ours.boot()

    again = [ours.after_service(code) for code in (5, 1, -9, 4, 5)]

    assert again == [True, True, True, True, False]
    assert "5 times" in cloud.mark().text
    assert cloud.wanted == 0


def test_requests_are_signed_as_the_aws_library_signs_them(monkeypatch, machine):
    ours = machine()
    monkeypatch.setattr(boot, "ROOT", str(ours.root))
    monkeypatch.setattr(boot, "_metadata", ours.metadata.address)
    monkeypatch.setenv("AWS_ENDPOINT_URL", "https://s3.us-east-1.amazonaws.com")

    url, headers = boot.Machine().signed("s3", "PUT", "/models/a wheel+1.whl", b"content")

    found = re.search(r"SignedHeaders=([^,]+), Signature=(\w+)", headers["authorization"])
    assert found is not None
    signed = {name: headers[name] for name in found[1].split(";")}
    request = AWSRequest("PUT", url, headers=signed, data=b"content")
    request.context["timestamp"] = headers["x-amz-date"]
    signer = S3SigV4Auth(
        Credentials(KEYS["AccessKeyId"], KEYS["SecretAccessKey"]), "s3", "us-east-1"
    )
    text = signer.string_to_sign(request, signer.canonical_request(request))
    assert found[2] == signer.signature(text, request)
