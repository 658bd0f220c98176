"""`.server.json` beside the buckets: the local server's port, keys and process."""

import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from drcli.base import notices
from drcli.base.errors import StorageError
from drcli.base.json_record import RecordError, from_json, parse_json
from drcli.base.regular_file import read_regular
from drcli.base.system_calls import flush_descriptor
from drcli.config.bucket_config import Engine, StorageConfig
from drcli.store.endpoint import Endpoint
from drcli.store.server import server_process

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
            state = from_json(cls, parse_json(read_regular(path)))
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
            notices.warn(f"{path} is damaged: {e}. The local server gets new access keys; {where}.")
            return None

    def write(self, path: Path) -> None:
        """In one step; others can never read the keys."""
        fresh = path.with_suffix(".new")
        fresh.unlink(missing_ok=True)
        try:
            with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as f:
                json.dump(asdict(replace(self, inode=path.parent.stat().st_ino)), f)
                f.flush()
                flush_descriptor(f.fileno())
            fresh.replace(path)
        except OSError:
            fresh.unlink(missing_ok=True)
            raise

    @property
    def mark(self) -> str:
        """By which we recognise its process."""
        where = f"127.0.0.1:{self.port}"
        return f"drcli.store.server.moto_server {self.port}" if self.engine == "moto" else where

    @property
    def is_running(self) -> bool:
        return self.pid is not None and server_process.is_running(self.pid, self.mark)

    def end(self) -> None:
        if self.pid is not None:
            server_process.end(self.pid, self.mark)

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
