"""Starts and stops TensorBoard for a working folder."""

import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from drcli.base.clock import wait_until
from drcli.base.errors import NotAvailable, SettingsError
from drcli.base.files import load_record, save_record
from drcli.base.json_record import Pid, SafeInt, Seconds
from drcli.base.processes import is_alive, started_s
from drcli.base.report import Col, View, bold, counted, dim, table
from drcli.bucket.bucket import Bucket
from drcli.bucket.server.server import free_port, is_free
from drcli.config import secret_environment
from drcli.config.run_config import FigureConfig
from drcli.config.settings import Settings
from drcli.metrics.event_file import FROM_HISTORY, PATTERN, EventFile
from drcli.metrics.figure_events import TrainingFacts
from drcli.metrics.open_sinks import event_folder, tensorboard_folder
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore
from drcli.run.read_logs import text_tail
from drcli.run.timed_uploads import fetch_event_files
from drcli.train.learner_metrics import earlier_points

USUAL_PORT = 6006
READY_S = 180.0
"""A training may have taken all cores."""

STOPPING_S = 10.0

_RECORD = "server.json"


@dataclass(frozen=True)
class ServerRecord:
    pid: Pid
    began_s: Seconds
    port: SafeInt


@dataclass(frozen=True)
class Tool:
    """A tool that gets the figures of trainings."""

    name: Annotated[str, "TensorBoard, Grafana, Prometheus, MLflow or trackio.", Col("tool")]
    setting: Annotated[str, "What switches it on.", Col("setting")]
    place: Annotated[
        str, "Where the figures go; empty if they do not.", Col("place", lambda text: text or "off")
    ]


@dataclass(frozen=True)
class MetricsReport:
    """Where the figures of trainings can be seen."""

    url: Annotated[str | None, "Address of TensorBoard; null if it does not run."]
    pid: Annotated[int | None, "Its process."]
    folder: Annotated[str, "With the event files."]
    written: Annotated[
        list[str], "Models whose event files were made from their history just now."
    ] = field(default_factory=list)
    tools: Annotated[list[Tool], "All tools, and which of them get figures."] = field(
        default_factory=list
    )
    fetched: Annotated[
        list[str], "Models of which the bucket had event files that were not here."
    ] = field(default_factory=list)

    def view(self) -> View:
        fetched, written = counted(len(self.fetched), "model"), counted(len(self.written), "model")
        names = ", ".join(self.fetched)
        return [
            self.url and ("TensorBoard: ", bold(self.url)),
            self.url and dim(f"Process {self.pid} shows {self.folder}."),
            self.fetched and f"Brought event files of {fetched} from the bucket: {names}.",
            self.written and f"Made event files of {written}: {', '.join(self.written)}.",
            "Figures of the next training go to:",
            table(self.tools),
        ]


def tools_of(config: FigureConfig, directory: Path) -> list[Tool]:
    host, port = config.telegraf_host, config.telegraf_port
    served = f"http://{config.prometheus_host}:{config.prometheus_port}/metrics"
    return [
        Tool(
            "TensorBoard",
            "DR_TENSORBOARD",
            str(event_folder(directory)) if config.tensorboard else "",
        ),
        Tool("Grafana", "DR_TELEGRAF_HOST", f"udp://{host}:{port}" if host else ""),
        Tool(
            "Prometheus (file)",
            "DR_PROMETHEUS_FOLDER",
            str(directory / config.prometheus_folder) if config.prometheus_folder else "",
        ),
        Tool("Prometheus", "DR_PROMETHEUS_PORT", served if config.prometheus_port else ""),
        Tool("MLflow", "DR_MLFLOW_URL", config.mlflow_url),
        Tool("trackio", "DR_TRACKIO_URL", config.trackio_url),
    ]


def check_tensorboard(settings: Settings) -> None:
    """NotAvailable without TensorBoard and other tools that get figures."""
    tools = tools_of(settings.run.figures, settings.directory)
    others = any(tool.place for tool in tools if tool.name != "TensorBoard")
    if not is_installed() and not others:
        raise NotAvailable(
            "TensorBoard is not installed, and no other tool gets the figures of trainings.",
            remedy='Install it with `pip install "drcli[tensorboard]"`; or set DR_TELEGRAF_HOST '
            "for Grafana, DR_PROMETHEUS_PORT, DR_MLFLOW_URL or DR_TRACKIO_URL in system.env.",
        )


def is_installed() -> bool:
    return importlib.util.find_spec("tensorboard") is not None


def fetch_events(settings: Settings, bucket: Bucket, prefixes: Sequence[str]) -> list[str]:
    """The models with event files that were not here.

    Raises:
        StorageError: The bucket cannot be read.
        SettingsError: The files cannot be written.
    """
    most_bytes = settings.run.logs.log_max_mb << 20
    return [
        prefix
        for prefix in prefixes
        if fetch_event_files(
            ModelStore(bucket, prefix), tensorboard_folder(settings.directory, prefix), most_bytes
        )
    ]


def write_histories(settings: Settings, bucket: Bucket, prefixes: Sequence[str]) -> list[str]:
    """Make event files for trainings without them.

    Raises:
        StorageError: The bucket cannot be read.
    """
    if not is_installed():
        return []
    return [prefix for prefix in prefixes if _write_history(settings, ModelStore(bucket, prefix))]


def start_tensorboard(
    settings: Settings,
    written: Sequence[str] = (),
    port: int | None = None,
    fetched: Sequence[str] = (),
) -> MetricsReport:
    """Start it unless it runs or is not installed.

    Raises:
        SettingsError: It does not start.
    """
    directory = settings.directory
    folder, tools = event_folder(directory), tools_of(settings.run.figures, directory)
    if not is_installed():
        return MetricsReport(None, None, str(folder), [], tools)
    record = running_tensorboard(directory) or _start(directory, folder, port)
    url = f"http://127.0.0.1:{record.port}/"
    return MetricsReport(url, record.pid, str(folder), list(written), tools, list(fetched))


def stop_tensorboard(directory: Path) -> ServerRecord | None:
    """SettingsError if it does not end."""
    record = running_tensorboard(directory)
    path = event_folder(directory) / _RECORD
    if record is None:
        path.unlink(missing_ok=True)
        return None
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.kill(record.pid, number)
        if wait_until(lambda: not is_alive(record.pid, record.began_s), patience_s=STOPPING_S):
            path.unlink(missing_ok=True)
            return record
    raise SettingsError(
        f"TensorBoard (process {record.pid}) does not end.",
        remedy="Look at that process with `ps`; it may wait for a disk.",
    )


def running_tensorboard(directory: Path) -> ServerRecord | None:
    record = load_record(ServerRecord, event_folder(directory) / _RECORD)
    if record is None or not is_alive(record.pid, record.began_s):
        return None
    return record


def _write_history(settings: Settings, model: ModelStore) -> bool:
    folder = tensorboard_folder(settings.directory, model.prefix)
    if any(folder.glob(PATTERN)):
        return False
    points = earlier_points(read_history(model))
    if not points:
        return False
    try:
        EventFile(
            folder, TrainingFacts(model.prefix, settings.run_id), points, FROM_HISTORY
        ).close()
    except OSError as error:
        raise SettingsError(
            f"{error.filename or folder}: cannot be written ({error.strerror or error}).",
            remedy=f"Check that you can write {folder}, and that its disk has room.",
        ) from None
    return True


def _start(directory: Path, folder: Path, port: int | None) -> ServerRecord:
    folder.mkdir(parents=True, exist_ok=True)
    chosen = _choose_port(port)
    log = directory / "data" / "logs" / "tensorboard.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    plain, _ = secret_environment.split(os.environ)
    with log.open("wb") as file:
        process = subprocess.Popen(
            [
                *(sys.executable, "-P", "-m", "tensorboard.main"),
                *("--logdir", str(folder), "--host", "127.0.0.1", "--port", str(chosen)),
                # Its faster reader keeps what was given up before a start.
                *("--load_fast", "false"),
            ],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            env=plain,
            cwd=directory,
            start_new_session=True,
        )
    record = ServerRecord(process.pid, started_s(process.pid) or 0.0, chosen)
    save_record(folder / _RECORD, record)

    def done() -> bool:
        return process.poll() is not None or not is_free(chosen)

    if wait_until(done, patience_s=READY_S) and process.poll() is None:
        process.returncode = 0  # nobody waits for it: it outlives this command
        return record
    process.kill()
    process.wait()
    (folder / _RECORD).unlink(missing_ok=True)
    lines = [line for line in text_tail(log, 4000).splitlines() if line.strip()] or ["empty"]
    raise SettingsError(
        f"TensorBoard does not start; the last line of its log is {lines[-1][:300]}.",
        remedy=f"Read {log}, or choose another port with --port.",
    )


def _choose_port(port: int | None) -> int:
    if port is None:
        return USUAL_PORT if is_free(USUAL_PORT) else free_port()
    if not is_free(port):
        raise SettingsError(
            f"Port {port} is taken by another program.",
            remedy="Choose another one with --port, or leave it out.",
        )
    return port
