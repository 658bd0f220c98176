"""The files for other launchers: by their own validators where installed, and tried in a fake root.

In the fake root, `dr-start-training` is a script that notes how it was called and signalled.
"""

import configparser
import importlib.util
import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

FOLDER = Path(__file__).resolve().parents[2] / "scripts" / "launchers"
COMMAND = "dr-start-training --resume-or-start --foreground"
INTERRUPTED, STOPPED, WRONG_SETTING, END_WORK_FAILED = 75, 143, 3, 10
UNITS = ["dr-training.service", "dr-training-system.service"]
SCRIPTS = ["slurm.sh", "cloud-boot.sh"]


def text(name: str) -> str:
    return (FOLDER / name).read_text("utf-8")


def commands(script: str) -> list[str]:
    """The lines of a script that start a training, without its folder."""
    stripped = (line.strip().replace('"', "") for line in script.splitlines())
    lines = [line for line in stripped if "dr-start-training -" in line]
    return [line[line.index("dr-start-training") :] for line in lines]


@pytest.mark.parametrize("name", ["skypilot.yaml", "kubernetes-job.yaml", *SCRIPTS, "crontab"])
def test_each_launcher_runs_the_one_command(name):
    [line] = [line for line in commands(text(name)) if not line.startswith("#")]

    assert line.startswith(COMMAND)


# SkyPilot


@pytest.fixture(scope="module")
def task():
    return yaml.safe_load(text("skypilot.yaml"))


def test_a_skypilot_job_recovers_from_interruptions_and_from_nothing_else(task):
    resources = task["resources"]

    assert resources["job_recovery"]["recover_on_exit_codes"] == [INTERRUPTED]
    assert [each["use_spot"] for each in resources["any_of"]] == [True, False]
    assert "max_restarts_on_errors" not in resources["job_recovery"]
    [hook] = task["config"]["hooks"]
    assert hook["events"] == ["preemption"]


def test_a_skypilot_task_fits_its_schema(task):
    if importlib.util.find_spec("sky") is None:
        pytest.skip("skypilot is not installed; docs/launchers.md says how it was checked")
    from sky.utils import common_utils, schemas

    common_utils.validate_schema(task, schemas.get_task_schema(), "")


def test_the_hook_of_skypilot_interrupts_what_runs_and_waits_for_its_end(task, tmp_path):
    record = tmp_path / "home/sky_workdir/data/runs/0/run.json"
    record.parent.mkdir(parents=True)
    ended = tmp_path / "ended"
    trap = f"trap 'sleep 0.2; touch {ended}; exit 75' TERM; echo; while :; do sleep 0.05; done"
    training = subprocess.Popen(["/bin/sh", "-c", trap], stdout=subprocess.PIPE)
    with training.stdout as ready:
        ready.readline()
    record.write_text(
        f'{{\n  "run_id": 0,\n  "state": "running",\n  "pid": {training.pid},\n  "workers": [\n'
        '    {\n      "pid": 1,\n      "name": "x"\n    }\n  ]\n}'
    )
    hook = subprocess.Popen(
        ["/bin/bash", "-c", task["config"]["hooks"][0]["run"]],
        env={**os.environ, "HOME": str(tmp_path / "home")},
    )

    assert training.wait(20) == INTERRUPTED  # and so it is no zombie that the hook waits for
    assert hook.wait(20) == 0
    assert ended.exists()


def test_the_scripts_of_skypilot_are_shell(task):
    for script in (task["setup"], task["run"], task["config"]["hooks"][0]["run"]):
        subprocess.run(["bash", "-n"], input=script.encode(), check=True)


# systemd


class Unit(configparser.RawConfigParser):
    """A unit file, whose keys have capital letters."""

    def optionxform(self, optionstr: str) -> str:
        return optionstr


def unit(content: str) -> Unit:
    parsed = Unit(strict=True, interpolation=None)
    parsed.read_string(content)
    return parsed


@pytest.mark.parametrize("name", UNITS)
def test_a_unit_starts_again_after_interruptions_only(name):
    service = unit(text(f"systemd/{name}"))["Service"]

    assert service["ExecStart"].endswith(COMMAND)
    assert service["RestartForceExitStatus"] == str(INTERRUPTED)
    assert set(service["SuccessExitStatus"].split()) == {str(INTERRUPTED), str(STOPPED)}
    assert service["Restart"] == "on-abnormal"  # an exit code such as 3 is not abnormal
    assert service["KillMode"] == "mixed"
    assert int(service["TimeoutStopSec"]) >= 60


@pytest.mark.parametrize("name", UNITS)
def test_systemd_accepts_the_units(name, tmp_path):
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("systemd-analyze is not installed")
    lines = text(f"systemd/{name}").splitlines()
    own = {"ExecStart": "/bin/true", "WorkingDirectory": "/tmp", "User": "root"}
    changed = [
        f"{key}={own[key]}" if (key := line.partition("=")[0]) in own else line for line in lines
    ]
    (tmp_path / name).write_text("\n".join(changed) + "\n")

    done = subprocess.run(
        [program, "verify", *(["--user"] if "system" not in name else []), tmp_path / name],
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
    )

    assert (done.returncode, done.stderr) == (0, "")


# Kubernetes


@pytest.fixture(scope="module")
def job():
    return yaml.safe_load(text("kubernetes-job.yaml"))


def test_a_job_replaces_interrupted_pods_and_ends_for_good_on_failures(job):
    rules = job["spec"]["podFailurePolicy"]["rules"]
    codes = {
        rule["action"]: rule["onExitCodes"]["values"] for rule in rules if "onExitCodes" in rule
    }
    pod = job["spec"]["template"]["spec"]

    assert rules[0]["onPodConditions"][0]["type"] == "DisruptionTarget"
    assert codes["Ignore"] == [INTERRUPTED]
    assert {WRONG_SETTING, STOPPED, END_WORK_FAILED} <= set(codes["FailJob"])
    assert INTERRUPTED not in codes["FailJob"]
    assert pod["restartPolicy"] == "Never"  # podFailurePolicy requires it
    assert pod["terminationGracePeriodSeconds"] >= 60
    assert rules[1]["onExitCodes"]["containerName"] == pod["containers"][0]["name"]


def test_a_pod_writes_only_to_its_volumes(job):
    pod = job["spec"]["template"]["spec"]
    [container] = pod["containers"]
    volumes = {volume["name"]: volume for volume in pod["volumes"]}

    assert container["securityContext"]["readOnlyRootFilesystem"]
    assert {each["name"] for each in container["volumeMounts"]} == set(volumes)
    assert "emptyDir" in volumes["racing"]
    assert not any("SECRET" in each["name"] for each in container["env"])


def test_kubernetes_accepts_the_job(job):
    if importlib.util.find_spec("kubernetes_validate") is None:
        pytest.skip("kubernetes-validate is not installed; docs/launchers.md says what was checked")
    import kubernetes_validate

    kubernetes_validate.validate(job, "1.31", strict=True)


def test_in_a_pod_the_signal_reaches_the_training(job, fake_root):
    script = job["spec"]["template"]["spec"]["containers"][0]["args"][0]
    settings, racing = fake_root.path / "settings", fake_root.path / "racing"
    for folder in (settings, racing):
        folder.mkdir()
    (settings / "run.env").write_text("DR_WORKERS=1\n")
    script = script.replace("/settings", str(settings)).replace("/racing", str(racing))
    fake_root.training("trap 'exit 75' TERM; echo ready; while :; do sleep 0.05; done")

    pod = fake_root.start(["/bin/sh", "-euc", script], cwd=racing)
    assert pod.stdout.readline() == "ready\n"
    pod.send_signal(signal.SIGTERM)

    assert pod.wait(20) == INTERRUPTED
    assert (racing / "run.env").exists()


# Shell scripts


class FakeRoot:
    """A folder of programs that note how they are called."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.calls = path / "calls"
        self.calls.touch()
        self.bin = path / "bin"
        self.bin.mkdir()
        self.started: list[subprocess.Popen[str]] = []

    def program(self, name: str, body: str = "") -> None:
        file = self.bin / name
        file.write_text(f'#!/bin/sh\necho "{name} $*" >>{self.calls}\n{body}\n')
        file.chmod(0o755)

    def training(self, body: str) -> None:
        self.program("dr-start-training", body)

    def start(self, command, **options) -> "subprocess.Popen[str]":
        env = {
            **os.environ,
            "PATH": f"{self.bin}:{os.environ['PATH']}",
            "DRCLI_BIN": str(self.bin),
            "SLURM_JOB_ID": "17",
            "SLURM_SUBMIT_DIR": str(self.path),
            **options.pop("env", {}),
        }
        self.started.append(
            subprocess.Popen(
                command, env=env, stdout=subprocess.PIPE, text=True, **{"cwd": self.path, **options}
            )
        )
        return self.started[-1]

    @property
    def called(self) -> list[str]:
        return self.calls.read_text().splitlines()


@pytest.fixture
def fake_root(tmp_path) -> Iterator[FakeRoot]:
    root = FakeRoot(tmp_path)
    root.program("squeue", "echo RUNNING")
    root.program("scontrol")
    yield root
    for process in root.started:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.parametrize("name", SCRIPTS)
def test_the_shell_scripts_are_clean(name):
    near = Path(sys.executable).with_name("shellcheck")
    program = str(near) if near.exists() else shutil.which("shellcheck")
    if program is None:
        subprocess.run(["bash", "-n", FOLDER / name], check=True)
        pytest.skip("shellcheck is not installed; bash can read the script")
    done = subprocess.run([program, FOLDER / name], capture_output=True, text=True)

    assert (done.returncode, done.stdout) == (0, "")


def test_slurm_reads_its_options():
    """Slurm stops at the first line that is neither empty nor a comment."""
    options = {}
    for line in text("slurm.sh").splitlines():
        if line.startswith("#SBATCH "):
            name, _, value = line.split()[1].partition("=")
            options[name] = value
        elif line and not line.startswith("#"):
            break

    assert "--requeue" in options
    target, _, name_and_time = options["--signal"].partition(":")
    assert (target, name_and_time) == ("B", "TERM@120")
    assert options["--open-mode"] == "append"  # or the next job overwrites the log


@pytest.mark.parametrize(
    ("code", "requeued"),
    [(0, False), (INTERRUPTED, True), (STOPPED, False), (3, False), (9, False), (10, False)],
)
def test_slurm_queues_an_interrupted_job_again(fake_root, code, requeued):
    fake_root.training(f"exit {code}")

    job = fake_root.start(["bash", FOLDER / "slurm.sh"])

    assert job.wait(20) == code
    assert fake_root.called[0] == COMMAND
    assert ("scontrol requeue 17" in fake_root.called) == requeued


def test_slurm_passes_the_signal_on_and_waits_for_the_training(fake_root):
    fake_root.training(
        "trap 'sleep 0.3; echo saved; exit 75' TERM; echo ready; while :; do sleep 0.05; done"
    )
    job = fake_root.start(["bash", FOLDER / "slurm.sh"])
    assert job.stdout.readline() == "ready\n"

    job.send_signal(signal.SIGTERM)

    assert job.wait(20) == INTERRUPTED
    assert job.stdout.read() == "saved\n"
    assert fake_root.called[-1] == "scontrol requeue 17"


@pytest.mark.parametrize("trap", ["trap 'exit 75' TERM", ":"])
def test_slurm_passes_on_a_signal_that_comes_during_the_start(fake_root, trap):
    fake_root.training(f"{trap}; kill -TERM $PPID; while :; do sleep 0.05; done")

    job = fake_root.start(["bash", FOLDER / "slurm.sh"])

    assert job.wait(20) == INTERRUPTED
    assert fake_root.called[-1] == "scontrol requeue 17"


def test_slurm_does_not_queue_a_cancelled_job_again(fake_root):
    fake_root.training(f"exit {INTERRUPTED}")
    fake_root.program("squeue", "echo COMPLETING")

    job = fake_root.start(["bash", FOLDER / "slurm.sh"])

    assert job.wait(20) == INTERRUPTED
    assert not any("scontrol" in call for call in fake_root.called)


def test_ray_accepts_the_file_for_its_autoscaler():
    """By the schema and the defaults of Ray itself; no cloud is asked."""
    pytest.importorskip("ray", reason="the extra ray is not installed")
    from ray.autoscaler._private.util import prepare_config, validate_config

    config = prepare_config(yaml.safe_load(text("ray-cluster.yaml")))

    validate_config(config)
    types = config["available_node_types"]
    spot = {name for name, each in types.items() if "InstanceMarketOptions" in each["node_config"]}
    assert spot == set(types) - {config["head_node_type"]}
    assert sum(types[name]["max_workers"] for name in spot) == config["max_workers"]
    # Ray adds commands of its own, and only the virtual environment has pip.
    commands = [*config["head_setup_commands"], *config["worker_setup_commands"]]
    assert not [line for line in commands if line.startswith("pip ")]


@pytest.mark.skipif(shutil.which("flock") is None, reason="flock is not installed")
def test_the_line_for_cron_starts_one_training_at_a_time(fake_root):
    lines = [line for line in text("crontab").splitlines() if line and line[0] != "#"]
    entry = lines[-1].split(maxsplit=5)
    variables = dict(line.split("=", 1) for line in lines[:-1])
    racing = fake_root.path / "my racing"
    racing.mkdir()
    places = {"RACING": str(racing), "DRCLI": str(fake_root.bin)}
    assert set(places) < set(variables)
    assert entry[:5] == ["*/2", "*", "*", "*", "*"]
    assert "%" not in entry[5]  # cron takes it for a new line
    fake_root.training("echo ready; echo ready >up; read -r line <go; exit 0")
    for pipe in ("up", "go"):
        os.mkfifo(racing / pipe)

    running = fake_root.start(["/bin/sh", "-c", entry[5]], env=places)
    assert (racing / "up").read_text() == "ready\n"
    second = fake_root.start(["/bin/sh", "-c", entry[5]], env=places)
    assert second.wait(20) != 0
    (racing / "go").write_text("go\n")
    assert running.wait(20) == 0

    assert fake_root.called == [COMMAND]
    assert (racing / "data/cron.log").read_text() == "ready\n"


def test_a_machine_of_a_cloud_installs_once_and_trains_from_every_boot_on(fake_root):
    root = fake_root.path / "root"
    fake_root.program(
        "python3",
        f'mkdir -p "{root}/opt/drcli/bin"; cp {fake_root.bin}/pip "{root}/opt/drcli/bin/pip"; '
        f'cp {fake_root.bin}/dr-start-training "{root}/opt/drcli/bin/"',
    )
    for name in ("apt-get", "useradd", "id", "chown", "pip", "systemctl", "dr-start-training"):
        fake_root.program(name)
    env = {"ROOT": str(root), "MODEL": "team/car-1", "DRCLI": "./drcli.whl"}

    for _ in range(2):
        boot = fake_root.start(["bash", FOLDER / "cloud-boot.sh"], env=env)
        assert boot.wait(30) == 0

    assert sum(call.startswith("python3 -m venv") for call in fake_root.called) == 1
    assert fake_root.called.count("systemctl enable --now dr-training.service") == 2
    service = unit((root / "etc/systemd/system/dr-training.service").read_text())["Service"]
    command, *options = shlex.split(service["ExecStart"])
    assert (Path(command).name, options) == ("dr-start-training", COMMAND.split()[1:])
    assert os.access(command, os.X_OK)
    assert "team/car-1" in (root / "srv/racing/run.env").read_text()
    own = unit(text("systemd/dr-training-system.service"))["Service"]
    for key in ("SuccessExitStatus", "RestartForceExitStatus", "Restart", "KillMode"):
        assert service[key] == own[key]
