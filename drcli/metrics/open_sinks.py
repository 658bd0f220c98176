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
    given, host, port = parameters or {}, config.prometheus_host, config.prometheus_port
    # Each loads its libraries when it is needed, and in the thread that sends.
    sinks: list[tuple[object, Callable[[], Sink]]] = [
        (
            config.tensorboard,
            lambda: EventFile(tensorboard_folder(directory, facts.model), facts, earlier),
        ),
        (
            config.prometheus_folder,
            lambda: FigureFile(directory / config.prometheus_folder, facts),
        ),
        (port, lambda: FigureServer(host, port, facts)),
        (
            config.mlflow_url,
            lambda: servers.MlflowRun(
                config.mlflow_url, config.mlflow_experiment, facts, given, earlier
            ),
        ),
        (
            config.trackio_url,
            lambda: servers.TrackioRun(config.trackio_url, config.trackio_project, facts, given),
        ),
    ]
    openers = [opener for wanted, opener in sinks if wanted]
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
    return [partial(InfluxLines, config.telegraf_host, config.telegraf_port, model)]
