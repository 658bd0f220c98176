"""Starts and stops the console of a working folder."""

import http.client
import importlib.util
import os
import secrets as random_secrets
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

from drcli.base.clock import wait_until
from drcli.base.errors import NotAvailable, SettingsError
from drcli.base.files import exclusive, load_record, write_private_json
from drcli.base.json_record import Pid, SafeInt, Seconds
from drcli.base.processes import is_alive, started_s
from drcli.config import secret_environment
from drcli.config.run_config import WebConfig
from drcli.run.read_logs import text_tail
from drcli.web.listen import ENTER, Listen

# The libraries of the extra `web`, which may be missing.


_NEEDED = ("starlette", "uvicorn", "websockets")


def require_web() -> None:
    """Raise NotAvailable if a library is missing."""
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise NotAvailable(
            f"The console needs {' and '.join(missing)}.",
            remedy="Install the extra: `pip install 'drcli[web]'`.",
        )


READY_S = 60.0
STOPPING_S = 10.0

PORT_S = 2.0
_LEAST_TOKEN = 16


@dataclass(frozen=True)
class ViewerRecord:
    """`began_s` as in `drcli.base.processes`."""

    pid: Pid
    began_s: Seconds
    host: str
    port: SafeInt
    token: str = ""


@dataclass(frozen=True)
class _Token:
    token: str


@dataclass(frozen=True)
class ViewerReport:
    """The console of a working folder."""

    url: Annotated[
        str | None, "Its address, with the token if it needs one; null if it does not run."
    ]
    pid: Annotated[int | None, "Its process."]
    host: Annotated[str, "The address that it listens at."]
    port: Annotated[int, "Its port."]
    needs_token: Annotated[bool, "Whether who opens it needs the token."]
    started: Annotated[bool, "Whether this command has started it."]


def start_viewer(
    directory: Path,
    config: WebConfig,
    *,
    again: bool = False,
    environ: Mapping[str, str] | None = None,
) -> ViewerReport:
    """Start the console of a folder; `again` first ends one that runs.

    `environ` is what it reads settings with, if not our own environment.

    Raises:
        NotAvailable: The extra `web` is not installed.
        SettingsError: The port is taken, or it does not start.
        OSError: The folder cannot be written.
    """
    require_web()
    path = _record_path(directory)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with exclusive(
        path.with_name("start.lock"),
        patience_s=READY_S,
        what="the console of this folder",
        failure=SettingsError,
    ):
        before = load_record(ViewerRecord, path)
        running = running_viewer(directory)
        if running is not None and not again:
            return report_of(running, started=False)
        # Pages that are open go on if they find the console where it was.
        usual = before.port if before is not None else config.port
        moves = running is None or (running.host, running.port) != (config.host, config.port)
        if moves and config.is_chosen:
            with _bound(config, usual) as bound:  # before the old one ends, which may stay the only
                stop_viewer(directory)
                return _start(directory, config, bound, environ)
        stop_viewer(directory)
        if before is not None and not config.is_chosen:
            # Threads of a killed process may live a moment longer than it, and keep its port.
            wait_until(lambda: not _answers(before.host, before.port), patience_s=PORT_S)
        with _bound(config, usual) as bound:
            return _start(directory, config, bound, environ)


def _start(
    directory: Path,
    config: WebConfig,
    bound: socket.socket,
    environ: Mapping[str, str] | None,
) -> ViewerReport:
    port = int(bound.getsockname()[1])
    token = _own_token(directory) if config.asks_token else ""
    log = log_path(directory)
    log.parent.mkdir(parents=True, exist_ok=True)
    environment, _ = secret_environment.split(os.environ if environ is None else environ)
    secrets = secret_environment.all_secrets()
    with log.open("ab") as file:
        process = subprocess.Popen(
            [*(sys.executable, "-P", "-m", "drcli.web.serve"), str(directory)],
            stdin=subprocess.PIPE,
            stdout=file,
            stderr=subprocess.STDOUT,
            env=environment,
            cwd=directory,
            pass_fds=[bound.fileno()],
            start_new_session=True,
        )
    assert process.stdin is not None
    # Through a pipe: everybody can read the arguments of a process.
    with suppress(BrokenPipeError), process.stdin as pipe:
        pipe.write(Listen(bound.fileno(), token, secrets).line())
    record = ViewerRecord(process.pid, started_s(process.pid) or 0.0, config.host, port, token)
    write_private_json(_record_path(directory), asdict(record))
    wait_until(
        lambda: process.poll() is not None or _answers(config.host, port), patience_s=READY_S
    )
    if process.poll() is None and _answers(config.host, port):
        process.returncode = 0  # nobody waits for it: it outlives this command
        return report_of(record, started=True)
    process.kill()
    process.wait()
    _record_path(directory).unlink(missing_ok=True)
    said = ([line for line in text_tail(log, 4000).splitlines() if line.strip()] or ["nothing"])[-1]
    raise SettingsError(
        f"The console does not start; the last line of its log is: {said[:300]}.",
        remedy=f"Read {log}, or choose another port with DR_WEBVIEWER_PORT in system.env.",
    )


def stop_viewer(directory: Path) -> ViewerRecord | None:
    """Stop the console, or raise SettingsError; None if none runs."""
    record = running_viewer(directory)
    if record is None:
        with suppress(OSError):  # a stale record is harmless
            _record_path(directory).unlink()
        return None
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.kill(record.pid, number)
        if wait_until(lambda: not is_alive(record.pid, record.began_s), patience_s=STOPPING_S):
            _record_path(directory).unlink(missing_ok=True)
            return record
    raise SettingsError(
        f"The console (process {record.pid}) does not end.",
        remedy="Look at that process with `ps`; it may wait for a disk.",
    )


def running_viewer(directory: Path) -> ViewerRecord | None:
    """None: none runs."""
    record = load_record(ViewerRecord, _record_path(directory))
    if record is None or not is_alive(record.pid, record.began_s):
        return None
    return record


def report_of(record: ViewerRecord, *, started: bool) -> ViewerReport:
    host = record.host if record.host not in ("0.0.0.0", "::") else _own_address()
    shown = f"[{host}]" if ":" in host else host
    path = f"{ENTER}?token={quote(record.token, safe='')}" if record.token else "/"
    url = f"http://{shown}:{record.port}{path}"
    return ViewerReport(url, record.pid, record.host, record.port, bool(record.token), started)


def _own_address() -> str:
    with suppress(OSError), socket.socket(type=socket.SOCK_DGRAM) as probe:
        # Nothing is sent: this only asks which address would be used. Source: RFC 5737, an
        # address for documentation.
        probe.connect(("192.0.2.1", 9))
        return str(probe.getsockname()[0])
    return socket.gethostname()


def log_path(directory: Path) -> Path:
    return directory / "data" / "logs" / "viewer.log"


def _record_path(directory: Path) -> Path:
    return directory / "data" / "viewer" / "viewer.json"


def _own_token(directory: Path) -> str:
    """Stays the same, so that bookmarks and cookies do."""
    path = directory / "data" / "viewer" / "token.json"
    known = load_record(_Token, path)
    if known is not None and len(known.token) >= _LEAST_TOKEN:
        return known.token
    token = random_secrets.token_urlsafe(24)
    write_private_json(path, {"token": token})
    return token


def _bound(config: WebConfig, usual: int) -> socket.socket:
    """A socket at the chosen port; without a choice, at the usual or any other.

    The console gets this socket, so nobody can take the port in between.
    """
    family = socket.AF_INET6 if ":" in config.host else socket.AF_INET
    reason = ""
    for wanted in [config.port] if config.is_chosen else [usual, config.port, 0]:
        bound = socket.socket(family)
        try:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.bind((config.host, wanted))
        except OSError as error:
            bound.close()
            reason = error.strerror or str(error)
        else:
            return bound
    raise SettingsError(
        f"{config.port_place}: the console cannot listen on {config.host} port {config.port} "
        f"({reason}).",
        remedy="Choose another port with -p PORT, or another DR_WEBVIEWER_PORT or "
        "DR_WEBVIEWER_HOST in system.env.",
    )


def _answers(host: str, port: int) -> bool:
    """The console itself, not only the system for it."""
    target = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    connection = http.client.HTTPConnection(target, port, timeout=2.0)
    try:
        connection.request("GET", "/icon.svg")
        connection.getresponse()
    except (OSError, http.client.HTTPException):
        return False
    else:
        return True
    finally:
        connection.close()
