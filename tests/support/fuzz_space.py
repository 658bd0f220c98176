"""A working folder in which any command line may be tried, and what must hold after each."""

import glob
import json
import os
import re
import shutil
import signal
import tarfile
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import psutil

from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server
from drcli.config.loading import load_settings
from forks import Forks
from old_model import extract_old_model

PATIENCE_S = 60.0
"""A command that takes longer hangs. The machine may be busy, and every call of a reward function
may take 5 s."""

CODES = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 75, 130, 143}
"""Exit codes in `dr --help`."""

FOREIGN = "foreign-signals"
"""File, in the folder above the working folder, with signals to processes of somebody else."""

FIRST = f"""
import os, pathlib, signal, socket, sys

ROOT = os.getcwd()
LOCAL = (None, "", "localhost", "127.0.0.1", "::1", b"localhost", b"127.0.0.1", b"::1")
resolve = socket.getaddrinfo

def local_only(host, *arguments, **options):
    if host not in LOCAL:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
    return resolve(host, *arguments, **options)

socket.getaddrinfo = local_only

def is_ours(pid):
    try:
        line = pathlib.Path(f"/proc/{{pid}}/cmdline").read_bytes().replace(b"\\0", b" ")
        state = pathlib.Path(f"/proc/{{pid}}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return True  # nobody gets the signal
    return os.fsencode(ROOT) in line or int(state[1]) == os.getpid() or pid == os.getpid()

def guarded(real):
    def send(pid, number):
        if number and not is_ours(abs(pid)):
            with open(os.path.join(ROOT, "{FOREIGN}"), "a") as file:
                file.write(f"{{pid}} {{number}} {{sys.argv}}\\n")
            raise ProcessLookupError(3, "No such process")
        return real(pid, number)
    return send

os.kill, os.killpg = guarded(os.kill), guarded(os.killpg)
"""
"""No example leaves the machine, and none sends a signal to a process that is not its own."""

THEN = """
from drcli.records.job import Job

def spawn(job, command, **options):
    sys.stdout.flush()
    sys.stderr.write("A worker would start.\\n")
    sys.stderr.flush()
    os._exit(0)

Job.spawn = spawn
"""
"""A command that gets as far as to start workers has accepted its input, and ends there."""

UNCHANGED = ("run.env", "system.env", "worker-2.env", "custom_files/", "data/s3/", "given/")
"""What a command that fails must leave as it was."""

VOLATILE = re.compile(
    r"data/s3/\.|data/s3/[^/]+$|\.bak(-\d+)?$|/__pycache__/|/runs/[^/]+/(lease\.json|damaged/)"
)
"""State and logs of the local server, copies before a change, and the lease that shows a start."""

TRACEBACK = re.compile(r"Traceback \(most recent call last\)|Internal error in drcli")

DISPLAYS = {
    *("status", "summary", "find-sagemaker", "find-robomaker", "get-robomaker-stats"),
    *("logs", "logs-sagemaker", "logs-robomaker", "list-models", "list-aws-models", "validate"),
    *("update", "update-env", "reload", "url", "reward", "shell-env"),
}
"""Commands that change nothing in the bucket and no file of the racer, whatever they answer."""


@dataclass
class FuzzSpace:
    """A racer's working folder with a trained model in its bucket.

    Attributes:
        folder: The working folder.
        bucket: The bucket, as plain files.
    """

    root: Path
    folder: Path = field(init=False)
    bucket: Path = field(init=False)

    def __post_init__(self) -> None:
        self.folder = self.root / "racer"
        self.bucket = self.folder / "data" / "s3" / "bucket"
        self.forks = Forks(self.root, first=FIRST, then=THEN, patience_s=PATIENCE_S)
        self.environment = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(("DR_", "DROA_", "AWS_"))
        }
        self.environment |= {
            "HOME": str(self.root / "home"),
            "XDG_CACHE_HOME": str(self.root / "home" / ".cache"),
            "AWS_SHARED_CREDENTIALS_FILE": str(self.root / "credentials"),
            "AWS_EC2_METADATA_DISABLED": "true",
            "OMP_NUM_THREADS": "1",
            "PATH": "/usr/bin:/bin",
            "COLUMNS": "100",
        }
        self._write_files()
        self._start_server()
        self._snapshot: dict[str, bytes | None] = {}
        self._stamps: dict[str, tuple[int, ...]] = {}
        self._keep()

    def _write_files(self) -> None:
        (self.root / "home").mkdir()
        extract_old_model(self.bucket)
        shutil.copytree(self.bucket / "custom_files", self.folder / "custom_files")
        (self.bucket.parent / "uploads").mkdir()
        (self.folder / "run.env").write_text(
            "# My racer\n"
            "DR_WORLD_NAME=reinvent_base\n"
            "DR_LOCAL_S3_MODEL_PREFIX=model\n"
            'DR_CAR_NAME="My car"\n'
            "DR_RACE_TYPE=TIME_TRIAL\n"
            "DR_EVAL_NUMBER_OF_TRIALS=1\n"
            "DR_WORKERS=1\n"
            "DR_UPLOAD_S3_PREFIX=$DR_LOCAL_S3_MODEL_PREFIX-1\n"
        )
        (self.folder / "system.env").write_text(
            "DR_CLOUD=local\nDR_LOCAL_S3_BUCKET=bucket\n"
            "DR_UPLOAD_S3_BUCKET=uploads\nDR_UPLOAD_S3_PROFILE=uploads\n"
        )
        (self.folder / "worker-2.env").write_text("DR_WORLD_NAME=reinvent_base\n")
        logs = self.folder / "data" / "logs"
        shutil.copytree(self.bucket / "model" / "logs" / "sagemaker", logs / "sagemaker" / "model")
        shutil.copytree(self.bucket / "model" / "logs" / "robomaker", logs / "robomaker" / "model")
        self._write_given()
        self._write_records()

    def _write_given(self) -> None:
        """Files that options name: a model of somebody else, a route, another reward function."""
        import numpy as np

        given = self.folder / "given"
        shutil.copytree(self.bucket / "model", given / "model")
        shutil.rmtree(given / "model" / "logs")
        with tarfile.open(given / "model.tar.gz", "w:gz", compresslevel=1) as archive:
            archive.add(given / "model", "model")
        angle = np.linspace(0.0, 2 * np.pi, 60)
        centre = np.stack([5 * np.cos(angle), 3 * np.sin(angle)], axis=1)
        np.save(given / "oval.npy", np.hstack([centre, centre * 0.9, centre * 1.1]))
        (given / "reward.py").write_text("def reward_function(params):\n    return 1.0\n")
        (given / "password").write_text("car-password\n")

    def _write_records(self) -> None:
        """What a run that ended has left in the folder and in the bucket."""
        from drcli.records.run_record import Lease, RunRecord

        run = RunRecord(
            run_id=0,
            session="abc",
            bucket="bucket",
            prefix="model",
            world="reinvent_base",
            state="finished",
            pid=os.getpid(),  # of another process, which nobody may end
            pid_started=1.0,
            started_at=1.7e9,
        )
        (self.folder / "data" / "runs" / "0").mkdir(parents=True)
        run.write(self.folder / "data" / "runs" / "0")
        lease = Lease("abc", "a-host", 4242, 1.7e9, term=1, released=True)
        path = self.bucket / "runs" / "model" / "lease.json"
        path.write_bytes(lease.encode())

    def _start_server(self) -> None:
        endpoint = server.ensure_running(self._storage())
        self._state = self._state_file.read_bytes()
        self._clients = {name: S3Bucket(endpoint, name) for name in ("bucket", "uploads")}
        state = json.loads(self._state)
        self.server_url = f"http://127.0.0.1:{state['port']}"
        (self.root / "credentials").write_text(
            f"[uploads]\naws_access_key_id={state['access_key']}\n"
            f"aws_secret_access_key={state['secret_key']}\n"
        )
        with (self.folder / "system.env").open("a") as file:
            file.write(f"DR_UPLOAD_S3_ENDPOINT_URL={self.server_url}\n")

    @property
    def _state_file(self) -> Path:
        return self.bucket.parent / ".server.json"

    def _revive_server(self) -> None:
        """Start the server again, with the same port and keys, where an example has ended it."""
        with suppress(OSError):
            if self._state_file.read_bytes() == self._state:
                return
        self._end_servers()
        state = {**json.loads(self._state), "pid": None, "watcher": None}
        self._remove(self._state_file)
        self._state_file.write_text(json.dumps(state))
        server.ensure_running(self._storage())
        self._state = self._state_file.read_bytes()

    def _end_servers(self) -> None:
        """End all S3 servers of the folder, also those that no file names any more."""
        self._end_processes(self.bucket.parent)

    def _end_processes(self, folder: Path, *, but: Path | None = None) -> None:
        """End what works on files below a folder, as its command line says."""
        for process in psutil.process_iter():
            with suppress(psutil.Error):
                line = " ".join(process.cmdline())
                if str(folder) in line and (but is None or str(but) not in line):
                    process.kill()
                    process.wait(10)

    def _storage(self) -> Any:
        from drcli.config.run_config import StorageConfig

        return StorageConfig("local", "bucket", self.bucket.parent)

    def close(self) -> None:
        """End everything that runs."""
        self.forks.close()
        self._end_processes(self.folder)

    # What is where.

    def _files(self) -> dict[str, tuple[int, ...]]:
        """Every path below the folder, with what changes when it is written."""
        found: dict[str, tuple[int, ...]] = {}
        for place, folders, names in os.walk(self.folder):
            for name in [*folders, *names]:
                path = os.path.join(place, name)  # noqa: PTH118  ten times as fast
                stat = os.lstat(path)
                is_folder = name in folders and not os.path.islink(path)  # noqa: PTH114  likewise
                key = os.path.relpath(path, self.folder) + ("/" if is_folder else "")
                found[key] = (
                    (stat.st_mode,)
                    if is_folder
                    else (stat.st_mode, stat.st_size, stat.st_mtime_ns, stat.st_ino)
                )
        return found

    def _keep(self) -> None:
        self._stamps = self._files()
        self._snapshot = {
            name: None if name.endswith("/") else (self.folder / name).read_bytes()
            for name in self._stamps
        }

    def restore(self) -> None:
        """Undo every change since the beginning."""
        self._revive_server()
        if any((self.folder / "data" / name).exists() for name in ("tensorboard", "viewer")):
            # A TensorBoard or a console that the example has started.
            self._end_processes(self.folder, but=self.bucket.parent)
        now = self._files()
        doomed: dict[str, list[str]] = {}
        keep = (".server.json", ".server.log", ".server.lock")
        for name in sorted(now.keys() - self._stamps.keys(), reverse=True):
            if name.endswith(keep):
                continue
            place = self._key(name)
            if place and not name.endswith("/"):
                doomed.setdefault(place[0], []).append(place[1])
            else:
                self._remove(self.folder / name)
        for bucket, objects in doomed.items():
            self._clients[bucket].delete(objects)
        for name in sorted(self._stamps):
            if now.get(name) == self._stamps[name] or name.endswith(keep):
                continue
            path = self.folder / name
            data = self._snapshot[name]
            if data is not None and self._key(name):
                self.put(*self._key(name), data)
                continue
            self._remove(path, only_files=data is None)
            if data is None:
                path.mkdir(exist_ok=True, parents=True)
            else:
                path.write_bytes(data)
            path.chmod(self._stamps[name][0] & 0o7777)
        self._stamps = {n: s for n, s in self._files().items() if n in self._stamps}
        for extra in (self.root / "home").iterdir():
            self._remove(extra)

    def put(self, bucket: str, key: str, data: bytes) -> None:
        """Write an object through the server, which may keep what it knows for a second."""
        self._clients[bucket].put(key, data)

    @staticmethod
    def _key(name: str) -> tuple[str, str] | tuple[()]:
        """Bucket and key of a file that the local server serves."""
        found = re.fullmatch(r"data/s3/(bucket|uploads)/(.+)", name)
        return (found[1], found[2]) if found else ()

    @staticmethod
    def _remove(path: Path, *, only_files: bool = False) -> None:
        if path.is_symlink() or (path.exists() and not path.is_dir()):
            path.unlink()
        elif path.is_dir() and not only_files:
            shutil.rmtree(path)

    # One example.

    def call(
        self, arguments: list[str], environment: dict[str, str] | None = None
    ) -> "CompletedProcess[str]":
        """Run a command line, and check what must hold after any."""
        before = self._files()
        environment = {**self.environment, **(environment or {})}
        done = self.forks.run(arguments, self.folder, environment)
        told = f"\ndr {' '.join(map(_short, arguments))}\ncode {done.returncode}\n"
        told += f"{done.stdout[-2000:]}\n{done.stderr[-3000:]}"
        assert done.returncode != -signal.SIGKILL, f"it hangs{told}"
        assert done.returncode in CODES, f"unknown exit code{told}"
        assert not TRACEBACK.search(done.stdout + done.stderr), f"a traceback{told}{self._crash()}"
        assert not self._crash(), f"a crash file{told}{self._crash()}"
        if done.returncode not in {0, 1, 2, 130, 143}:
            # `dr shell-env` speaks for activate.sh.
            said = "Error: " in done.stderr or done.stderr.startswith("activate.sh: ")
            assert said or _reports_errors(done.stdout), f"no sentence{told}"
        assert not (self.root / FOREIGN).exists(), f"signals to others{told}"
        self._check_changes(before, done, told)
        return done

    def _check_changes(
        self, before: dict[str, tuple[int, ...]], done: "CompletedProcess[str]", told: str
    ) -> None:
        words = [word for word in done.args if not word.startswith("-")]
        if done.returncode == 0 and not (words and words[0] in DISPLAYS):
            return
        after = self._files()
        changed = {
            name
            for name in before.keys() | after.keys()
            if before.get(name) != after.get(name)
            and name.startswith(UNCHANGED)
            and not name.endswith("/")
            and not VOLATILE.search(name)
            and not self._was_repaired(name)
        }
        assert not changed, f"changed {sorted(changed)}{told}"

    def _was_repaired(self, name: str) -> bool:
        """Whether an object was damaged, and a copy of it was kept."""
        damaged = self.bucket / "runs" / "model" / "damaged"
        key = (
            name.removeprefix("data/s3/bucket/").removeprefix("runs/model/").removeprefix("model/")
        )
        return any(damaged.glob(f"{glob.escape(key)}.*"))

    def _crash(self) -> str:
        """The traceback of an internal error, if there was one."""
        texts = [path.read_text() for path in self.folder.glob("data/logs/crash-*.txt")]
        return "".join(f"\n{text}" for text in texts)

    def settings(self) -> Any:
        """The settings of the folder."""
        return load_settings(self.folder, environ={})


def _short(word: str) -> str:
    return ascii(word) if len(word) < 400 else f"{word[:20]!a} ... ({len(word)} letters)"


def _reports_errors(out: str) -> bool:
    """Whether a report of all checks, which is a result, names an error and a remedy."""
    return ("Errors\n" in out and "Try: " in out) or '"errors": [{"' in out
