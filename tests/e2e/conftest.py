"""A racer's working folder with real commands, real workers and a real bucket, kept small."""

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest

from amazon_server import amazon_server
from drcli.bucket.connect import open_bucket
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.transfer.ready_made import put_ready_made, read_ready_made
from forks import PATIENCE_S, Forks

PREFIX = "model"


class Workspace:
    """A folder in which commands are run as a user runs them."""

    prefix = PREFIX

    def __init__(self, folder: Path, forks: Forks) -> None:
        self.folder = folder
        self._forks = forks
        self.reset()

    def reset(self) -> None:
        """Write a racer's files anew."""
        self.environment = {k: v for k, v in os.environ.items() if not k.startswith("DR_")}
        self.environment["OMP_NUM_THREADS"] = "1"
        (self.folder / "system.env").write_text("DR_CLOUD=local\nDR_LOCAL_S3_BUCKET=bucket\n")
        self.write_run_env()
        self.hyperparameters: dict[str, Any] = {
            "batch_size": 32,
            "num_epochs": 3,
            "num_episodes_between_training": 4,
            "term_cond_max_episodes": 3,
        }
        self.write_custom_files()

    def write_run_env(self, **values: object) -> None:
        lines = {
            "DR_WORLD_NAME": "reinvent_base",
            "DR_LOCAL_S3_MODEL_PREFIX": PREFIX,
            "DR_TRAIN_MIN_EVAL_TRIALS": 1,
            "DR_TRAIN_SEED": 7,
            "DR_EVAL_MAX_RESETS": 0,
            **values,
        }
        (self.folder / "run.env").write_text("".join(f"{k}={v}\n" for k, v in lines.items()))

    def write_custom_files(self, reward: str = "    return 1.0\n") -> None:
        custom = self.folder / "custom_files"
        custom.mkdir(exist_ok=True)
        (custom / "reward_function.py").write_text(f"def reward_function(params):\n{reward}")
        (custom / "hyperparameters.json").write_text(json.dumps(self.hyperparameters))
        actions = [{"steering_angle": s, "speed": 2.0} for s in (-20.0, 0.0, 20.0)]
        (custom / "model_metadata.json").write_text(
            json.dumps(
                {
                    "action_space": actions,
                    "action_space_type": "discrete",
                    "sensor": ["FRONT_FACING_CAMERA"],
                    "neural_network": "COMPACT_CONVOLUTIONAL_NETWORK",
                    "training_algorithm": "clipped_ppo",
                    "version": "5",
                }
            )
        )

    def put_bucket(self, source: Path) -> None:
        """Lay down a bucket of another folder as this one's, before anything was started."""
        shutil.copytree(source, self.model.parent)

    def put(self, trained: "Trained") -> None:
        """Lay down the bucket and the logs of a training as this folder's."""
        self.put_bucket(trained.bucket)
        shutil.copytree(trained.logs, self.folder / "data" / "logs")

    def put_ready_made(self, *names: str) -> None:
        """Put ready-made models into the bucket, each under its own name."""
        for name in names:
            put_ready_made(
                read_ready_made(name),
                self.settings(),
                name,
                lambda *_: nullcontext(lambda _: None),
            )

    def start(self, command: str, *options: str) -> "subprocess.Popen[str]":
        """Start the installed program of a command."""
        return subprocess.Popen(
            [str(Path(sys.executable).parent / f"dr-{command}"), *options],
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, command: str, *options: str) -> "subprocess.CompletedProcess[str]":
        """Run a command to its end, in a process that has everything loaded when it begins.

        What its workers need they load themselves.
        """
        done = self._forks.run([command, *options], self.folder, self.environment)
        if done.returncode == -signal.SIGKILL:
            pytest.fail(f"{command} did not end.\n{done.stdout}\n{done.stderr}\n{self.logs()}")
        return done

    def end_of(
        self, process: "subprocess.Popen[str]", patience_s: float = PATIENCE_S
    ) -> "subprocess.CompletedProcess[str]":
        """Wait for the end of a command; a failure to end shows what its workers said."""
        try:
            out, err = process.communicate(timeout=patience_s)
        except subprocess.TimeoutExpired:
            os.kill(process.pid, signal.SIGKILL)
            out, err = process.communicate()
            pytest.fail(f"{process.args} did not end.\n{out}\n{err}\n{self.logs()}")
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def settings(self) -> Settings:
        return load_settings(self.folder, environ={})

    def bucket(self) -> S3Bucket:
        return open_bucket(self.settings().storage)

    def status(self) -> dict[str, Any]:
        report: dict[str, Any] = json.loads(self.run("status", "--json").stdout.splitlines()[-1])
        return report

    def record(self) -> dict[str, Any]:
        path = self.folder / "data" / "runs" / "0" / "run.json"
        record: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
        return record

    def pid_of(self, worker: str) -> int | None:
        return next(
            (w["pid"] for w in self.record().get("workers", []) if w["name"] == worker), None
        )

    def server_pid(self) -> int:
        state = json.loads((self.folder / "data" / "s3" / ".server.json").read_text())
        return int(state["pid"])

    @property
    def model(self) -> Path:
        """The model's folder in the bucket, as plain files."""
        return self.folder / "data" / "s3" / "bucket" / PREFIX

    def log(self, worker: str) -> str:
        return next((self.folder / "data" / "logs").rglob(f"{worker}.log")).read_text()

    def iterations(self) -> int:
        path = self.model / "metrics" / "history.json"
        try:
            return len(json.loads(path.read_text())["iterations"])
        except (FileNotFoundError, ValueError):
            return 0

    def wait_for(
        self, condition: Callable[[], bool], what: str, patience_s: float = PATIENCE_S
    ) -> None:
        deadline = time.monotonic() + patience_s
        while not condition():
            assert time.monotonic() < deadline, f"waited in vain for {what}\n{self.logs()}"
            time.sleep(0.05)

    def logs(self) -> str:
        paths = sorted((self.folder / "data").rglob("*.log"))
        return "\n".join(f"== {path.name}\n{path.read_text()[-1500:]}" for path in paths)

    def clean_up(self) -> None:
        self.write_run_env()
        if (self.folder / "data" / "viewer").exists():
            self.run("stop-viewer")
        record = self.record()
        if record and psutil.pid_exists(record["pid"]) and record["state"] == "running":
            os.kill(record["pid"], signal.SIGTERM)
            psutil.wait_procs([psutil.Process(record["pid"])], timeout=20)
        server.stop(self.settings().storage)


class EmptyWorkspace(Workspace):
    """A folder in which nothing was written yet."""

    def reset(self) -> None:
        super().reset()
        for path in sorted(self.folder.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()

    def clean_up(self) -> None:
        self.run("stop-viewer")
        self.run("stop-all")


@pytest.fixture(scope="session")
def forks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Forks]:
    """Runs commands in processes that start quickly."""
    running = Forks(tmp_path_factory.mktemp("forks"))
    yield running
    running.close()


@pytest.fixture
def new_workspace(
    tmp_path_factory: pytest.TempPathFactory, forks: Forks
) -> Iterator[Callable[[], Workspace]]:
    """Makes working folders, each as good as a machine of its own."""
    made: list[Workspace] = []

    def make() -> Workspace:
        made.append(Workspace(tmp_path_factory.mktemp("racer"), forks))
        return made[-1]

    yield make
    for space in made:
        space.clean_up()


@pytest.fixture
def workspace(new_workspace: Callable[[], Workspace]) -> Workspace:
    return new_workspace()


@pytest.fixture
def empty_workspace(tmp_path: Path, forks: Forks) -> Iterator[EmptyWorkspace]:
    space = EmptyWorkspace(tmp_path, forks)
    yield space
    space.clean_up()


@pytest.fixture
def uploads() -> Iterator[S3Bucket]:
    """A bucket on a server of somebody else's."""
    with amazon_server() as address:
        endpoint = Endpoint(address, access_key="AKup", secret_key="secret")
        bucket = S3Bucket(endpoint, "uploads", patience_s=5)
        bucket.ensure_exists()
        yield bucket
        bucket.close()


@pytest.fixture(scope="module")
def shared_workspace(tmp_path_factory: pytest.TempPathFactory, forks: Forks) -> Iterator[Workspace]:
    """One working folder for all tests of a file."""
    space = Workspace(tmp_path_factory.mktemp("racer"), forks)
    yield space
    space.clean_up()


@dataclass(frozen=True)
class Trained:
    """A training of three iterations that somebody has run to its end.

    Attributes:
        bucket: Folder of its bucket, as plain files. Tests copy it.
        logs: Folder of its logs. Tests copy it.
        report: What the training said in JSON.
    """

    bucket: Path
    logs: Path
    report: dict[str, Any]


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory, forks: Forks) -> Trained:
    """One training for all tests that need a trained model and look at nothing but its end.

    The processes of a test session share it. The first that needs it trains, others wait.
    """
    folder = tmp_path_factory.getbasetemp()
    if os.environ.get("PYTEST_XDIST_WORKER"):
        folder = folder.parent
    result = folder / "trained" / "report.json"
    with (folder / "trained.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not result.exists():
            space = Workspace(tmp_path_factory.mktemp("racer"), forks)
            try:
                ended = space.run("start-training", "--json")
                assert ended.returncode == 0, ended.stderr + space.logs()
            finally:
                space.clean_up()
            shutil.copytree(space.model.parent, folder / "trained" / "bucket")
            shutil.copytree(space.folder / "data" / "logs", folder / "trained" / "logs")
            result.write_text(ended.stdout.splitlines()[-1])
    made = folder / "trained"
    return Trained(made / "bucket", made / "logs", json.loads(result.read_text()))
