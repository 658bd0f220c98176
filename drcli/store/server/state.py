"""What later commands need to know of the local server, in a file beside its buckets."""

import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from drcli.base import notices
from drcli.base.errors import StorageError
from drcli.base.json_record import Misfit, built, parsed
from drcli.config.settings import Engine, StorageConfig
from drcli.store.endpoint import Endpoint


@dataclass(frozen=True)
class ServerState:
    """A server that was started here; kept in a file that its owner alone can read.

    Attributes:
        access_key: Made for this bucket; they stay the same from start to start.
        pid: Its process; None where it was not started yet, or was stopped.
        watcher: The process that stops it when it is not used; None where none was started.
        idle_minutes: After how many minutes without use; 0 for never.
    """

    engine: Engine
    port: int
    access_key: str
    secret_key: str
    pid: int | None = None
    watcher: int | None = None
    idle_minutes: int = 10

    @classmethod
    def read(cls, path: Path) -> "ServerState | None":
        """Read the file; None if there is none. A damaged file is renamed.

        Raises:
            StorageError: It cannot be read.
        """
        try:
            return built(cls, parsed(path.read_bytes()))
        except FileNotFoundError:
            return None
        except OSError as e:
            raise StorageError(
                f"{path} cannot be read ({e.strerror or e}).",
                remedy="Run the command as the user who started the server.",
            ) from e
        except Misfit as e:
            kept = path.with_name(f"{path.name}.damaged")
            with suppress(OSError):
                path.replace(kept)
            notices.warn(
                f"{path} is damaged: {e}. The local server gets new access keys; the damaged file "
                f"is kept as {kept}."
            )
            return None

    def write(self, path: Path) -> None:
        """Write the file in one step; other users can never read the keys."""
        fresh = path.with_suffix(".new")
        fresh.unlink(missing_ok=True)
        try:
            with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as f:
                json.dump(asdict(self), f)
            fresh.replace(path)
        except OSError:
            fresh.unlink(missing_ok=True)
            raise

    @property
    def mark(self) -> str:
        """What the server's command line contains and no other does."""
        where = f"127.0.0.1:{self.port}"
        return f"drcli.store.server.moto_server {self.port}" if self.engine == "moto" else where

    def endpoint(self, config: StorageConfig) -> Endpoint:
        """The server as an address with keys."""
        return Endpoint(
            url=f"http://127.0.0.1:{self.port}",
            access_key=self.access_key,
            secret_key=self.secret_key,
            region=config.region,
            engine=self.engine,
            pid=self.pid,
            data_dir=config.data_dir,
        )


def own_file(config: StorageConfig, kind: Literal["json", "lock", "log"]) -> Path:
    """A file of ours beside the buckets: the state, the lock on it, or what the server says."""
    return config.data_dir / f".server.{kind}"
