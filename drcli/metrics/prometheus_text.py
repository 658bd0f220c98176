"""Newest figures of a training for Prometheus, by file or HTTP."""

import re
import socket
from collections.abc import Mapping
from pathlib import Path

from drcli.base.files import rewrite
from drcli.base.installation import lazy_imports
from drcli.metrics.figure_events import (
    Ended,
    EpisodePoint,
    EpochPoint,
    Event,
    Point,
    Sink,
    TrainingFacts,
)

with lazy_imports():
    import prometheus_client

_LETTERS = re.compile(r"[^a-zA-Z0-9_]")

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
    "training_running": "1 while the training runs.",
    "steps": "Steps learned from since the beginning.",
    "updated_seconds": "Unix time of the newest figure.",
}


class NewestFigures:
    """A collector with a registry of its own, so that nothing about Python is shown."""

    def __init__(self, facts: TrainingFacts) -> None:
        self._labels = {"model": facts.model, "run_id": str(facts.run_id)}
        self._learned: Mapping[str, float] = {}
        self._scores: Mapping[str, float] = {}
        self._step, self._time_s, self._is_running = facts.first_step, 0.0, True
        self._gather()
        self.registry = prometheus_client.CollectorRegistry()
        self.registry.register(self)

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
        self._gather()

    def collect(self) -> "list[prometheus_client.Metric]":
        """All of one moment."""
        return self._metrics

    def text(self) -> bytes:
        return prometheus_client.generate_latest(self.registry)

    def _gather(self) -> None:
        values = {
            **self._learned,
            **self._scores,
            "training_running": self._is_running,
            "steps": self._step,
            "updated_seconds": self._time_s,
        }
        metrics = []
        for name, value in sorted(values.items()):
            meaning = _MEANINGS.get(name, f"CleanRL's {name}.")
            metric = prometheus_client.Metric(metric_name(name), meaning, "gauge")
            metric.add_sample(metric.name, self._labels, float(value))
            metrics.append(metric)
        self._metrics = metrics


class NewestSink(Sink):
    """Shows the newest figures, so that none has to be sent again."""

    takes = (Point, Ended)
    _figures: NewestFigures

    def send(self, event: Event) -> None:
        self._figures.add(event)

    def miss(self, event: Event) -> bool:
        self._figures.add(event)
        return True


class FigureFile(NewestSink):
    """A `.prom` file for node_exporter's textfile collector, in its existing folder."""

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
        super().send(event)
        self._save()

    def miss(self, event: Event) -> bool:
        self._is_saved = False
        return super().miss(event)

    def close(self) -> None:
        if not self._is_saved:
            self._save()

    def _save(self) -> None:
        self._is_saved = False
        rewrite(self._path, self._figures.text())
        self._path.chmod(0o644)  # the collector is another user
        self._is_saved = True


class FigureServer(NewestSink):
    """An HTTP server of /metrics; the system chooses a port for 0.

    Raises:
        OSError: The port is taken, or the address is none of this machine.
    """

    def __init__(self, host: str, port: int, facts: TrainingFacts) -> None:
        self.name = f"DR_PROMETHEUS_PORT={port}"
        self._figures = NewestFigures(facts)
        try:
            self._server, _ = prometheus_client.start_http_server(
                port, host, self._figures.registry
            )
        except OSError as error:
            text = f"nothing can listen on {host}:{port}: {error.strerror or error}."
            raise OSError(error.errno, f"{self.name}: {text}") from None

    @property
    def port(self) -> int:
        return int(self._server.server_address[1])

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


def metric_name(name: str) -> str:
    """`losses/approx_kl` is deepracer_losses_approx_kl."""
    return "deepracer_" + _LETTERS.sub("_", name)


# InfluxDB's line protocol over UDP, for DeepRacer-for-Cloud's Grafana board.
#
# Sources: reference simulator (`dr_training_episodes`, `dr_eval_episodes`), board
# (`dr_sagemaker_epochs`).


_NAME = str.maketrans({",": r"\,", " ": r"\ ", "=": r"\=", "\n": " ", "\r": " "})


class InfluxLines(Sink):
    """Sends each event to Telegraf as a datagram, without confirmation.

    Lines have a time: our episodes of an iteration end together, and the server keeps one line of
    equal tags per second.
    """

    takes = (EpisodePoint, EpochPoint)

    def __init__(self, host: str, port: int, model: str) -> None:
        self.name = f"DR_TELEGRAF_HOST={host}"
        self._place = host, port
        self._model = model
        self._socket: socket.socket | None = None

    def send(self, event: Event) -> None:
        """Raises OSError for an unknown host or a refusing network."""
        assert isinstance(event, self.takes)
        data = line_of(event, self._model).encode()
        try:
            self._connected().send(data)
        except ConnectionRefusedError:
            # The answer to an earlier datagram: this one may be the first that is heard.
            self._connected().send(data)
        except OSError:
            self.close()  # the name may have another address when it is tried again
            raise

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def _connected(self) -> socket.socket:
        if self._socket is None:
            host, port = self._place
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
            family, kind, protocol, _, address = found[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.settimeout(1.0)
            self._socket.connect(address)
        return self._socket


def line_of(event: EpisodePoint | EpochPoint, model: str) -> str:
    if isinstance(event, EpochPoint):
        return _line("dr_sagemaker_epochs", {"model": model}, {"entropy": event.entropy}, event)
    tags = {"model": model, "status": event.status, "worker": str(event.worker)}
    fields: dict[str, float] = {"elapsed_time": event.elapsed_ms, "progress": event.progress}
    if event.resets is not None:
        return _line("dr_eval_episodes", tags, {**fields, "reset_count": event.resets}, event)
    tags["phase"] = event.phase
    return _line("dr_training_episodes", tags, {**fields, "reward": event.reward}, event)


def _line(
    name: str,
    tags: Mapping[str, str],
    fields: Mapping[str, float],
    event: EpisodePoint | EpochPoint,
) -> str:
    """Sorted by name; whole numbers are marked."""
    marks = "".join(f",{key}={text.translate(_NAME)}" for key, text in sorted(tags.items()) if text)
    values = ",".join(
        f"{key}={value}i" if isinstance(value, int) else f"{key}={value!r}"
        for key, value in sorted(fields.items())
    )
    return f"{name}{marks} {values} {round(event.time_s * 1e9)}"
