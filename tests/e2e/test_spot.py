"""A training on spot machines from the first command to the last, with moto for Amazon.

The old scripts are typed, the user data of the launch template are taken apart as cloud-init would
do it, the boot program runs in a fake root, and real trainings run, one on each machine.
"""

import base64
import gzip
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import requests
import yaml
from moto.server import ThreadedMotoServer

from fake_amazon import client
from fake_machine import FakeMachine

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.timeout(900),
    # moto makes no policies of buckets.
    pytest.mark.filterwarnings("ignore:Tried to parse"),
]

ROOT = Path(__file__).resolve().parents[2]
PROGRAMS = Path(sys.executable).parent
MODEL = "training/reinvent_base/first-model"
PATIENCE_S = 240.0
NOTICE_S, SPARE_S = 118.0, 30.0
"""What Amazon leaves a machine, and what must stay of it, on a machine with nothing else to do."""

RUN_ENV = """DR_RUN_ID=0
DR_WORLD_NAME=reinvent_base
DR_RACE_TYPE=TIME_TRIAL
DR_CAR_NAME=FastCar
DR_CAR_COLOR=Red
DR_TRAIN_MIN_EVAL_TRIALS=1
DR_TRAIN_SEED=7
DR_LOCAL_S3_MODEL_PREFIX=training/$DR_WORLD_NAME/first-model
DR_LOCAL_S3_CUSTOM_FILES_PREFIX=custom_files/$DR_WORLD_NAME/first-model
DR_UPLOAD_S3_PREFIX=upload/$DR_WORLD_NAME/first-model
DR_LOCAL_S3_PRETRAINED=False
DR_REGULAR_UPLOAD=0
DR_REGULAR_PHYSICAL_MODEL_UPLOAD=60
DR_CONTINUE_ON_SPOT_INTERRUPTION=True
DR_IMPORT_MODEL_ON_COMPLETION=False"""
"""As deepracer-on-the-spot has it, without a line end at its end."""

SYSTEM_ENV = """DR_CLOUD=aws
DR_AWS_APP_REGION=$DEEPRACER_REGION
DR_UPLOAD_S3_PROFILE=default
DR_UPLOAD_S3_BUCKET=$DEEPRACER_S3_URI
DR_LOCAL_S3_BUCKET=$DEEPRACER_S3_URI
DR_LOCAL_S3_PROFILE=default
DR_WORKERS=1
DR_DOCKER_STYLE=compose
DR_HOST_X=True
DR_DISPLAY=:99
"""


class Amazon:
    """moto, and commands that reach it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
        self.server.start()
        host, port = self.server.get_host_and_port()
        self.endpoint = f"http://{host}:{port}"
        # What other tests of this process made is not in the way of "nothing is left".
        requests.post(f"{self.endpoint}/moto-api/reset", timeout=10).raise_for_status()
        plain = {k: v for k, v in os.environ.items() if not k.startswith(("DR_", "AWS_"))}
        self.environment = {
            **plain,
            "PATH": f"{PROGRAMS}:{os.environ['PATH']}",
            "AWS_ENDPOINT_URL": self.endpoint,
            "AWS_ACCESS_KEY_ID": "testing",
            "AWS_SECRET_ACCESS_KEY": "testing",
            "AWS_CONFIG_FILE": "/nonexistent",
            "AWS_SHARED_CREDENTIALS_FILE": "/nonexistent",
            "DEEPRACER_INSTANCE_TYPE": "c7i.xlarge",
            "OMP_NUM_THREADS": "1",
        }

    def client(self, service: str) -> Any:
        return client(service, self.endpoint)

    def type(self, program: str | Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """Type a command in the racer's folder."""
        return subprocess.run(
            [str(program), *arguments],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            timeout=PATIENCE_S,
            check=False,
        )

    def spot(self, *arguments: str) -> Any:
        """The JSON that a command of dr-spot prints."""
        done = self.type(PROGRAMS / "dr-spot", *arguments, "--json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    def objects(self, bucket: str, start: str) -> list[str]:
        found = self.client("s3").list_objects_v2(Bucket=bucket, Prefix=start)
        return [entry["Key"] for entry in found.get("Contents", [])]

    def machine(self, root: Path, instance: str) -> FakeMachine:
        """A machine of the launch template, with what cloud-init would write on it."""
        ec2 = self.client("ec2")
        template = ec2.describe_launch_templates()["LaunchTemplates"][0]["LaunchTemplateId"]
        versions = ec2.describe_launch_template_versions(LaunchTemplateId=template)
        data = versions["LaunchTemplateVersions"][0]["LaunchTemplateData"]["UserData"]
        config = yaml.safe_load(base64.b64decode(data))
        files = {each["path"]: each["content"] for each in config["write_files"]}
        keys = {"AccessKeyId": "ASIAMACHINE", "SecretAccessKey": "secret", "Token": "token"}
        facts = json.loads(files["/etc/drcli/machine.json"])
        # Programs of the machine: this drcli, at the place where pip would put it.
        kept = {k: v for k, v in os.environ.items() if k in ("PYTHONPATH", "DRCLI_TEST_RUN")}
        settle = {"OMP_NUM_THREADS": "1", **kept}
        made = FakeMachine(root, facts, self.endpoint, keys, instance, settle)
        own = gzip.decompress(base64.b64decode(files["/opt/drcli/boot.py"]))
        assert own == (ROOT / "drcli/outside/aws/boot.py").read_bytes()
        programs = root / "opt/drcli/venv/bin"
        programs.mkdir(parents=True)
        for name in ("dr-start-training", "dr-stop-training"):
            (programs / name).write_text(f'#!/bin/sh\nexec "{PROGRAMS / name}" "$@"\n')
            (programs / name).chmod(0o755)
        return made


@pytest.fixture
def amazon(tmp_path: Path) -> Iterator[Amazon]:
    """Amazon, and a folder as users of deepracer-on-the-spot have it."""
    folder = tmp_path / "deepracer-on-the-spot"
    files = folder / "custom-files"
    files.mkdir(parents=True)
    shipped = ROOT / "defaults"
    for name in ("reward_function.py", "model_metadata.json", "hyperparameters.json"):
        (files / name).write_bytes((shipped / name).read_bytes())
    values = json.loads((files / "hyperparameters.json").read_text())
    values |= {"num_episodes_between_training": 4, "num_epochs": 3, "term_cond_max_episodes": 12}
    (files / "hyperparameters.json").write_text(json.dumps(values))
    (files / "run.env").write_text(RUN_ENV)
    (files / "system.env").write_text(SYSTEM_ENV)
    made = Amazon(folder)
    yield made
    made.server.stop()


def until(
    condition: Callable[[], object],
    what: str,
    program: "subprocess.Popen[bytes]",
    machine: FakeMachine,
) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if program.poll() is not None:
            said = machine.journal.read_text()
            pytest.fail(f"{what}: the training ended with {program.returncode}: {said}")
        assert time.monotonic() < end, what
        time.sleep(0.5)


def test_a_training_survives_its_machine_and_leaves_nothing_behind(amazon, tmp_path):
    scripts = ROOT / "scripts" / "spot"

    base = amazon.type(scripts / "create-base-resources.sh", "racing", "203.0.113.7", "--yes")
    assert base.returncode == 0, base.stderr
    asked = amazon.type(
        scripts / "create-spot-instance.sh", "racing", "run", "90", "--image", "ami-1e749f67"
    )
    assert asked.returncode == 1, "nobody has said yes"
    assert "At most" in asked.stderr
    assert [each["stack"] for each in amazon.spot("list")["stacks"]] == ["racing"]
    made = amazon.type(
        scripts / "create-spot-instance.sh", "racing", "run", "90", "--image", "ami-1e749f67", "-y"
    )
    assert made.returncode == 0, made.stderr
    stacks = {each["stack"]: each for each in amazon.spot("list")["stacks"]}
    bucket = stacks["run"]["bucket"]
    assert stacks["run"]["state"] == "booting"
    files = "custom_files/reinvent_base/first-model/reward_function.py"
    assert files in amazon.objects(bucket, "custom_files/")

    instance = stacks["run"]["machines"][0]["instance"]
    first = amazon.machine(tmp_path / "first", instance)
    second = amazon.machine(tmp_path / "second", "i-00000000000000002")
    try:
        booted = first.boot()
        assert booted.returncode == 0, booted.stdout
        program = first.service()
        wheels = [call for call in first.calls if call.startswith("pip") and ".whl" in call]
        assert len(wheels) == 1
        record = f"{MODEL}/model/1_Step"
        until(lambda: amazon.objects(bucket, record), "no first iteration", program, first)
        told_s = time.time()
        moment = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(told_s + NOTICE_S))
        notice = {"action": "terminate", "time": moment}
        first.metadata.describe({"spot/instance-action": json.dumps(notice)})
        code = program.wait(PATIENCE_S)
        assert code == 75, first.journal.read_text()
        assert time.time() - told_s < NOTICE_S - SPARE_S
        assert not first.after_service(75)
        uploaded = "upload/reinvent_base/first-model/model/deepracer_checkpoints.json"
        assert amazon.objects(bucket, uploaded), first.journal.read_text()
        assert amazon.objects(bucket, "upload/reinvent_base/first-model/carfile.tar.gz")
        assert amazon.objects(bucket, f"{MODEL}/logs/sagemaker/supervisor.log")
        assert amazon.spot("list")["stacks"][1]["machines"][0]["said"] == "interrupted"

        assert second.boot().returncode == 0
        program = second.service()
        code = program.wait(PATIENCE_S)
        assert code == 0, second.journal.read_text()
        assert not second.after_service(0)
    finally:
        first.close()
        second.close()

    group = amazon.client("autoscaling").describe_auto_scaling_groups()["AutoScalingGroups"][0]
    assert group["DesiredCapacity"] == 0
    history = amazon.client("s3").get_object(Bucket=bucket, Key=f"{MODEL}/metrics/history.json")
    records = json.loads(history["Body"].read())
    records = records if isinstance(records, list) else records["iterations"]
    assert [each["iteration"] for each in records] == list(range(12))
    best = [
        json.loads(amazon.client("s3").get_object(Bucket=bucket, Key=key)["Body"].read())
        for key in (uploaded, f"{MODEL}/model/deepracer_checkpoints.json")
    ]
    assert best[0]["last_checkpoint"]["name"] == best[1]["best_checkpoint"]["name"]
    report = {each["stack"]: each for each in amazon.spot("list")["stacks"]}["run"]
    assert report["state"] == "finished"
    assert {each["said"] for each in report["machines"]} == {"interrupted", "finished"}
    shown = amazon.type(PROGRAMS / "dr-spot", "logs", "run", "boot")
    assert "state: finished" in shown.stdout + shown.stderr or shown.returncode == 0

    assert amazon.type(PROGRAMS / "dr-spot", "delete", "run").returncode == 1, "nobody said yes"
    assert amazon.type(scripts / "stop-training.sh", "run").returncode == 0
    assert amazon.objects(bucket, f"{MODEL}/model/")
    assert amazon.objects(bucket, "spot/") == []
    gone = amazon.type(scripts / "delete-base-resources.sh", "racing", "--yes")
    assert gone.returncode == 0, gone.stderr
    assert amazon.spot("list")["stacks"] == []
    assert amazon.client("s3").list_buckets()["Buckets"] == []
    assert amazon.client("sns").list_topics()["Topics"] == []
    assert amazon.client("iam").list_roles()["Roles"] == []
