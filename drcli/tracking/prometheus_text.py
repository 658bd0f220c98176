"""Newest figures of a training for Prometheus, by file or HTTP."""

import re
import socket
import threading
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from drcli.base.atomic_file import rewrite
from drcli.tracking.figure_events import Ended, Event, Point, TrainingFacts

_PREFIX = "deepracer_"
_LETTERS = re.compile(r"[^a-zA-Z0-9_]")

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

_MEANINGS = {
    "charts/episodic_return": "Mean total reward of the training episodes of an iteration.",
    "charts/episodic_length": "Mean steps of the training episodes of an iteration.",
    "charts/SPS": "Steps learned from per second of wall time since the beginning.",
    "charts/learning_rate": "Learning rate.",
    "charts/episodic_progress": "Mean progress of the training episodes of an iteration, percent.",
    "charts/full_laps": "Training episodes of an iteration that completed a lap.",
    "evaluation/progress": "Mean progress of the evaluation of the newest scored checkpoint.",
    "evaluation/laps": "Clean laps of this evaluation.",
    "evaluation/clean_share": "Share of its laps that are clean.",
    "evaluation/best_lap_s": "Fastest of the clean laps, simulated seconds.",
    "evaluation/median_lap_s": "Median of the clean laps, simulated seconds.",
    "losses/entropy": "Entropy of the policy, nats.",
    "losses/approx_kl": "Divergence from the policy that drove.",
}


class NewestFigures:
    def __init__(self, facts: TrainingFacts) -> None:
        self._labels = f'{{model="{_escaped(facts.model)}",run_id="{facts.run_id}"}}'
        self._learned: Mapping[str, float] = {}
        self._scores: Mapping[str, float] = {}
        self._step, self._time_s, self._is_running = facts.first_step, 0.0, True
        self._text = ""
        self._write()

    def add(self, event: Event) -> None:
        assert isinstance(event, Point | Ended)
        if isinstance(event, Point):
            # A value that is missing now, such as a lap time, is not the one from before.
            if event.is_evaluation:
                self._scores = event.values
            else:
                self._learned = event.values
            self._step = max(self._step, event.step)
        else:
            self._is_running = False
        self._time_s = event.time_s
        self._write()

    def text(self) -> str:
        return self._text

    def _write(self) -> None:
        own = {
            "training_running": (float(self._is_running), "1 while the training runs."),
            "steps": (float(self._step), "Steps learned from since the beginning."),
            "updated_seconds": (self._time_s, "Unix time of the newest figure."),
        }
        known = {
            metric_name(name): (value, _MEANINGS.get(name, f"CleanRL's {name}."))
            for name, value in (*self._learned.items(), *self._scores.items())
        }
        self._text = "".join(
            f"# HELP {_PREFIX}{name} {meaning}\n# TYPE {_PREFIX}{name} gauge\n"
            f"{_PREFIX}{name}{self._labels} {value!r}\n"
            for name, (value, meaning) in sorted((known | own).items())
        )


class FigureFile:
    """A `.prom` file for node_exporter's textfile collector, in its existing folder."""

    takes = (Point, Ended)

    def __init__(self, folder: Path, facts: TrainingFacts) -> None:
        self.name = f"DR_PROMETHEUS_FOLDER={folder}"
        if not folder.is_dir():
            raise NotADirectoryError(f"DR_PROMETHEUS_FOLDER={folder} is not a folder.")
        letters = re.sub(r"[^A-Za-z0-9._-]", "_", facts.model)
        self._path = folder / f"deepracer-{letters}.prom"
        self._figures = NewestFigures(facts)
        self._is_saved = False
        self._save()

    def send(self, event: Event) -> None:
        """Replace the file in one step."""
        self._figures.add(event)
        self._save()

    def miss(self, event: Event) -> bool:
        self._figures.add(event)
        self._is_saved = False
        return True

    def close(self) -> None:
        if not self._is_saved:
            self._save()

    def _save(self) -> None:
        self._is_saved = False
        rewrite(self._path, self._figures.text().encode())
        self._path.chmod(0o644)  # the collector is another user
        self._is_saved = True


class FigureServer:
    """An HTTP server of /metrics; the system chooses a port for 0.

    Raises:
        OSError: The port is taken, or the address is none of this machine.
    """

    takes = (Point, Ended)

    def __init__(self, host: str, port: int, facts: TrainingFacts) -> None:
        self.name = f"DR_PROMETHEUS_PORT={port}"
        self._figures = NewestFigures(facts)
        try:
            self._server = _Server(host, port, _handler(self._figures.text))
        except OSError as error:
            text = f"nothing can listen on {host}:{port}: {error.strerror or error}."
            raise OSError(error.errno, f"{self.name}: {text}") from None
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="prometheus", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        return int(self._server.server_address[1])

    def send(self, event: Event) -> None:
        self._figures.add(event)

    def miss(self, event: Event) -> bool:
        self._figures.add(event)
        return True

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, host: str, port: int, handler: type[BaseHTTPRequestHandler]) -> None:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        self.address_family = found[0][0]  # IPv4 or IPv6
        super().__init__((host, port), handler)


def _handler(text: Callable[[], str]) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = 10.0  # of a client that sends nothing
        server_version, sys_version = "drcli", ""

        def do_GET(self) -> None:
            if self.path.partition("?")[0] not in ("/", "/metrics"):
                self.send_error(404)
                return
            data = text().encode()
            self.send_response(200)
            self.send_header("Content-Type", CONTENT_TYPE)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, format: str, *arguments: object) -> None:
            """Keeps requests out of the log."""

    return Handler


def metric_name(name: str) -> str:
    """`losses/approx_kl` is losses_approx_kl."""
    return _LETTERS.sub("_", name)


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
