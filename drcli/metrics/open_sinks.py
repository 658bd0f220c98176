"""Opens the sinks that settings ask for."""

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from drcli.base.errors import NotAvailable
from drcli.base.installation import lazy_imports
from drcli.config.run_config import FigureConfig
from drcli.metrics.event_file import EventFile
from drcli.metrics.figure_events import Point, Sink, TrainingFacts
from drcli.metrics.figure_sender import FigureSender
from drcli.metrics.prometheus_text import FigureFile, FigureServer, InfluxLines

with lazy_imports():
    from drcli.metrics import servers


def check_figures(config: FigureConfig) -> None:
    """Before a start; raises NotAvailable for a missing library."""
    if config.tensorboard and importlib.util.find_spec("tensorboard") is None:
        raise NotAvailable(
            "DR_TENSORBOARD=True needs the package tensorboard, which is not installed.",
            remedy='Install it with `pip install "drcli[tensorboard]"`, or set '
            "DR_TENSORBOARD=False.",
        )


def sender_of_trainer(
    config: FigureConfig,
    directory: Path,
    facts: TrainingFacts,
    *,
    earlier: Sequence[Point] = (),
    parameters: Mapping[str, str] | None = None,
) -> FigureSender:
    """`earlier` are points of iterations before, for sinks that lack them."""
    openers: list[Callable[[], Sink]] = []
    if config.tensorboard:
        folder = tensorboard_folder(directory, facts.model)
        openers.append(partial(_event_file, folder, facts, earlier))
    if config.prometheus_folder:
        openers.append(partial(_figure_file, directory / config.prometheus_folder, facts))
    if config.prometheus_port:
        openers.append(
            partial(_figure_server, config.prometheus_host, config.prometheus_port, facts)
        )
    if config.mlflow_url:
        openers.append(partial(_mlflow_run, config, facts, parameters or {}, earlier))
    if config.trackio_url:
        openers.append(partial(_trackio_run, config, facts, parameters or {}))
    return FigureSender([*openers, *_telegraf(config, facts.model)])


def sender_of_episodes(config: FigureConfig, model: str) -> FigureSender:
    """For a simulation worker or an evaluation."""
    return FigureSender(_telegraf(config, model))


def event_folder(directory: Path) -> Path:
    return directory / "data" / "tensorboard"


def tensorboard_folder(directory: Path, model: str) -> Path:
    return event_folder(directory) / model


def _telegraf(config: FigureConfig, model: str) -> list[Callable[[], Sink]]:
    if not config.telegraf_host:
        return []
    return [partial(_influx_lines, config.telegraf_host, config.telegraf_port, model)]


# Each loads its libraries when it is needed, and in the thread that sends.


def _event_file(folder: Path, facts: TrainingFacts, earlier: Sequence[Point]) -> Sink:
    return EventFile(folder, facts, earlier)


def _figure_file(folder: Path, facts: TrainingFacts) -> Sink:
    return FigureFile(folder, facts)


def _figure_server(host: str, port: int, facts: TrainingFacts) -> Sink:
    return FigureServer(host, port, facts)


def _mlflow_run(
    config: FigureConfig,
    facts: TrainingFacts,
    parameters: Mapping[str, str],
    earlier: Sequence[Point],
) -> Sink:
    return servers.MlflowRun(
        config.mlflow_url, config.mlflow_experiment, facts, parameters, earlier
    )


def _trackio_run(config: FigureConfig, facts: TrainingFacts, parameters: Mapping[str, str]) -> Sink:
    return servers.TrackioRun(config.trackio_url, config.trackio_project, facts, parameters)


def _influx_lines(host: str, port: int, model: str) -> Sink:
    return InfluxLines(host, port, model)
