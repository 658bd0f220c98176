"""Machines that train, and the bucket that outlives them: real commands, processes and files."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import psutil

from drcli.bucket.connect import FolderBucket
from drcli.bucket.server import server
from drcli.bucket.server.server_process import ServerState, own_file
from drcli.config.run_config import StorageConfig
from drcli.records.run_record import RunRecord, run_folder
from fault_metadata import MetadataServer
from fault_proxy import Proxy

BUCKET, PREFIX, PROFILE = "races", "team/model", "racer"

DEFAULTS = Path(__file__).resolve().parents[2] / "defaults"

CloudName = Literal["remote", "local"]

DISK_BYTES = 256 << 20
"""Size of the bucket's disk, which `fill` makes full."""


class Storage:
    """A bucket in a folder, served by rclone, with a disk of its own if this process may have one.

    The embedded server of a machine with DR_CLOUD=local and the server behind the proxies are the
    same one.
    """

    def __init__(self, folder: Path, *, disk: bool) -> None:
        self.folder = folder
        folder.mkdir(parents=True)
        self.has_disk = disk and _mount(folder)
        self.config = StorageConfig("local", BUCKET, folder)
        self.ensure_running()

    def ensure_running(self) -> None:
        """Start the server if it does not run."""
        server.ensure_running(self.config)

    @property
    def state(self) -> ServerState:
        """Port, keys and process of the server."""
        state = ServerState.read(own_file(self.folder, "json"))
        assert state is not None
        return state

    @property
    def bucket(self) -> FolderBucket:
        """The objects as they are on the disk; needs no server."""
        return FolderBucket(self.folder / BUCKET)

    def path(self, key: str) -> Path:
        """The file of an object."""
        return self.folder / BUCKET / key

    def fill(self) -> None:
        """Leave no room on the disk."""
        with suppress(OSError), (self.folder / "ballast").open("wb") as file:
            while True:
                file.write(b"\0" * (1 << 16))
                file.flush()

    def make_room(self) -> None:
        """Undo `fill`."""
        (self.folder / "ballast").unlink(missing_ok=True)

    def close(self) -> None:
        """End the server, and give the disk back."""
        server.stop(self.config)
        if self.has_disk:
            subprocess.run(["umount", "--lazy", str(self.folder)], check=True)


def _mount(folder: Path) -> bool:
    """Whether a small disk is now mounted at the folder."""
    if shutil.which("mount") is None or os.geteuid() != 0:
        return False
    size = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    return subprocess.run(size, capture_output=True).returncode == 0


class Machine:
    """A working folder on which a training runs, with a network and a clock of its own.

    Args:
        folder: Does not exist yet.
        storage: Where the model is.
        cloud: Whether the bucket is reached through the proxy or through the embedded server.
        iterations: The goal of the training.
        workers: DR_WORKERS.
        seed: Of the proxy's random numbers.
        shipped: Whether it trains with the files of `defaults/`.
    """

    def __init__(
        self,
        folder: Path,
        storage: Storage,
        *,
        cloud: CloudName,
        iterations: int,
        workers: int = 2,
        seed: int = 0,
        shipped: bool = False,
    ) -> None:
        self.folder = folder
        self.storage = storage
        self.cloud = cloud
        self.workers = workers
        self.proxy = Proxy(storage.state.port, seed)
        self.metadata = MetadataServer()
        self.starts = 0
        self.process: subprocess.Popen[bytes] | None = None
        folder.mkdir(parents=True)
        self._write_files(iterations)
        if shipped:
            for name in ("reward_function.py", "hyperparameters.json", "model_metadata.json"):
                shutil.copy(DEFAULTS / name, folder / "custom_files" / name)
        self.environment = self._environment()

    def start(self, *options: str) -> None:
        """Start the training in the foreground; what it says goes to `said_path`."""
        self.starts += 1
        with self.said_path.open("ab") as said:
            self.process = subprocess.Popen(
                [self.dr, "start-training", "--foreground", *options],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=subprocess.STDOUT,
            )

    @property
    def dr(self) -> str:
        """The program."""
        return str(Path(sys.executable).parent / "dr")

    def start_or_resume(self) -> None:
        """Start the training, or continue it if its model is in the bucket."""
        self.start("--resume-or-start")

    @property
    def said_path(self) -> Path:
        """What the newest start has said."""
        return self.folder / f"start-{self.starts}.txt"

    @property
    def running(self) -> bool:
        """Whether the start still runs."""
        return self.process is not None and self.process.poll() is None

    def record(self) -> RunRecord | None:
        """The record of the run; None before it is written."""
        return RunRecord.read(run_folder(self.folder, 0))

    def pid_of(self, name: str) -> int | None:
        """The process of a worker, the supervisor, the server or the watcher, if it lives."""
        if name in ("server", "watcher"):
            pid = getattr(self.storage.state, "pid" if name == "server" else "watcher")
        elif name == "supervisor":
            pid = self.process.pid if self.process is not None and self.running else None
        else:
            record = self.record()
            workers = record.workers if record is not None and record.alive else []
            pid = next((w.pid for w in workers if w.name == name), None)
        return pid if pid is not None and psutil.pid_exists(pid) else None

    def processes(self) -> list[psutil.Process]:
        """All processes of this machine, without the server."""
        return [process for process in psutil.process_iter() if works_in(process, self.folder)]

    def set_clock(self, ahead_s: float) -> None:
        """Let the clock of this machine be ahead of the real one."""
        fresh = self.folder / "clock.new"
        fresh.write_text(str(ahead_s))
        fresh.replace(self.folder / "clock")

    def vanish(self) -> None:
        """Kill all processes, and delete the folder and what else only this machine has."""
        for process in self.processes():
            with suppress(psutil.Error):
                process.kill()
        if self.process is not None:
            self.process.wait()
        psutil.wait_procs(self.processes(), timeout=30)
        shutil.rmtree(self.folder, ignore_errors=True)
        self.proxy.close()
        self.metadata.close()

    def logs(self) -> Iterator[tuple[str, str]]:
        """Name and text of each log, the newest parts included."""
        folder = self.folder / "data" / "logs"
        for path in sorted([*folder.rglob("*.log*"), *self.folder.glob("start-*.txt")]):
            with suppress(OSError):
                yield path.name, path.read_text("utf-8", "replace")

    def _environment(self) -> dict[str, str]:
        state = self.storage.state
        keys, config = self.folder / "credentials", self.folder / "aws_config"
        keys.write_text(
            f"[{PROFILE}]\naws_access_key_id = {state.access_key}\n"
            f"aws_secret_access_key = {state.secret_key}\n"
        )
        config.write_text(f"[profile {PROFILE}]\nregion = eu-west-1\n")
        places = [str(Path(__file__).parent / "clock"), os.environ.get("PYTHONPATH", "")]
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("DR_", "AWS_"))}
        return kept | {
            "OMP_NUM_THREADS": "1",
            "PYTHONPATH": os.pathsep.join(filter(None, places)),
            "FAULT_CLOCK": str(self.folder / "clock"),
            "AWS_SHARED_CREDENTIALS_FILE": str(keys),
            "AWS_CONFIG_FILE": str(config),
            "AWS_EC2_METADATA_SERVICE_ENDPOINT": self.metadata.url,
        }

    def _write_files(self, iterations: int) -> None:
        system = {"DR_CLOUD": self.cloud, "DR_LOCAL_S3_BUCKET": BUCKET}
        if self.cloud == "remote":
            system |= {"DR_REMOTE_MINIO_URL": self.proxy.url, "DR_LOCAL_S3_PROFILE": PROFILE}
        else:
            system["DR_S3_DATA_DIR"] = str(self.storage.folder)
        run = {
            "DR_WORLD_NAME": "reinvent_base",
            "DR_LOCAL_S3_MODEL_PREFIX": PREFIX,
            "DR_WORKERS": self.workers,
            "DR_TRAIN_MIN_EVAL_TRIALS": 1,
            "DR_TRAIN_SEED": 7,
        }
        for name, lines in (("system.env", system), ("run.env", run)):
            text = "".join(f"{key}={value}\n" for key, value in lines.items())
            (self.folder / name).write_text(text)
        custom = self.folder / "custom_files"
        custom.mkdir()
        (custom / "reward_function.py").write_text(
            "def reward_function(params):\n    return 1.0 + params['progress'] / 100.0\n"
        )
        actions = [{"steering_angle": angle, "speed": 2.0} for angle in (-20.0, 0.0, 20.0)]
        files: dict[str, dict[str, Any]] = {
            "hyperparameters.json": {
                "batch_size": 32,
                "num_epochs": 2,
                "num_episodes_between_training": 2 * self.workers,
                "term_cond_max_episodes": iterations,
            },
            "model_metadata.json": {
                "action_space": actions,
                "action_space_type": "discrete",
                "sensor": ["FRONT_FACING_CAMERA"],
                "neural_network": "COMPACT_CONVOLUTIONAL_NETWORK",
                "training_algorithm": "clipped_ppo",
                "version": "5",
            },
        }
        for name, content in files.items():
            (custom / name).write_text(json.dumps(content))


def works_in(process: psutil.Process, folder: Path) -> bool:
    """Whether a process lives whose working folder this is, or one in it."""
    with suppress(psutil.Error):
        zombie = process.status() == psutil.STATUS_ZOMBIE
        return not zombie and Path(process.cwd()).is_relative_to(folder)
    return False


def send(pid: int | None, number: signal.Signals) -> bool:
    """Send a signal to a process; False if it is gone."""
    if pid is None:
        return False
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return False
    return True


def now_s() -> float:
    """Monotonic seconds."""
    return time.monotonic()
