"""Examines what earlier runs left."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import psutil

from drcli.bucket.server import server
from drcli.bucket.server.server_process import ServerState, own_file
from drcli.checks.doctor.findings import Finding
from drcli.config.run_config import StorageConfig
from drcli.records.run_record import LIVE_STATES, RunRecord, running_evaluations

_WORKERS = (
    "drcli.train.sim",
    "drcli.train.trainer",
    "drcli.drive.evaluator",
    "drcli.drive.evaluate_many",
)


def examine_runs(directory: Path) -> Iterator[Finding]:
    """Those that run, and those that died without saying why."""
    paths = sorted((directory / "data" / "runs").glob("*/run.json"))
    read = {path: RunRecord.read(path.parent) for path in paths}
    records = [record for record in read.values() if record is not None]
    damaged = [path for path, record in read.items() if record is None]
    alive = [record for record in records if record.alive]
    lost = [each for each in records if each.state in LIVE_STATES and not each.alive]
    evaluations = running_evaluations(directory)
    launchers = {run.pid for run in alive} | {run.pid for run in evaluations}
    orphans = _orphans(directory, launchers)
    facts = {
        "training": [record.run_id for record in alive],
        "lost": [record.run_id for record in lost],
        "orphans": orphans,
        "damaged": [str(path) for path in damaged],
    }
    for record in lost:
        text = (
            f"run {record.run_id} of s3://{record.bucket}/{record.prefix} ended without a reason: "
            "it was killed, or the machine was restarted."
        )
        remedy = "Continue it with `dr-start-training --resume`."
        yield Finding("runs", "warning", text, remedy, facts)
    for path in damaged:
        text = f"{path} is damaged, so nobody knows whether that run has ended."
        yield Finding("runs", "warning", text, f"Delete {path.parent}.", facts)
    if orphans:
        numbers = " ".join(map(str, orphans))
        text = f"worker processes without a supervisor: {numbers.replace(' ', ', ')}."
        yield Finding("runs", "warning", text, f"End them with `kill -9 {numbers}`.", facts)
    if not (lost or damaged or orphans):
        running = [f"run {record.run_id} is training {record.prefix}" for record in alive]
        running += [f"run {each.run_id} evaluates {each.prefix}" for each in evaluations]
        text = "; ".join(running) or "nothing runs here, and nothing is left over"
        yield Finding("runs", "ok", text, facts=facts)


def examine_server(storage: StorageConfig) -> Iterator[Finding]:
    if storage.cloud != "local":
        return
    file = own_file(storage.data_dir, "json")
    state = ServerState.read(file) if file.exists() else None
    if state is not None and state.is_running:
        facts = {"running": True, "port": state.port, "pid": state.pid}
        text = f"{state.engine} runs on port {state.port} (process {state.pid})"
        yield Finding("server", "ok", text, facts=facts)
        return
    port = storage.port or (state.port if state is not None else None)
    facts = {"running": False, "port": port, "pid": None}
    if port is None or server.is_free(port):
        where = "any free port" if port is None else f"port {port}"
        text = f"{storage.engine} does not run; it starts on {where} when it is needed"
        yield Finding("server", "ok", text, facts=facts)
    elif storage.port is None:
        text = f"port {port} is taken by {who_listens(port)}; the server will use another one"
        yield Finding("server", "ok", text, facts=facts)
    else:
        text = f"port {port} (DR_LOCAL_S3_PORT) is taken by {who_listens(port)}."
        remedy = "End that program, or set DR_LOCAL_S3_PORT to a free port."
        yield Finding("server", "problem", text, remedy, facts)


def who_listens(port: int) -> str:
    """As far as this user may know."""
    with suppress(psutil.Error, OSError):
        for connection in psutil.net_connections("tcp"):
            if connection.status != psutil.CONN_LISTEN or connection.pid is None:
                continue
            if connection.laddr[1:] == (port,):
                name = psutil.Process(connection.pid).name()
                return f"{name} (process {connection.pid})"
    return "another program"


def _orphans(directory: Path, launchers: set[int]) -> list[int]:
    found = []
    for process in psutil.process_iter(["cmdline"]):
        words = process.info["cmdline"] or []
        if not any(worker in words for worker in _WORKERS):
            continue
        with suppress(psutil.Error, OSError):
            here = os.path.realpath(process.cwd()) == os.path.realpath(directory)
            parent = process.parent()
            if here and not (parent is not None and _launches(parent, launchers)):
                found.append(process.pid)
    return sorted(found)


def _launches(process: psutil.Process, launchers: set[int]) -> bool:
    if process.pid in launchers:
        return True
    words = process.cmdline()
    return any(word.startswith("drcli.") or _is_command(Path(word).name) for word in words)


def _is_command(name: str) -> bool:
    return name == "dr" or name.startswith("dr-")
