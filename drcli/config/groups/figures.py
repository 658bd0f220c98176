"""Live figures of a training for other tools."""

from drcli.config.fields import Group, setting
from drcli.config.figure_types import (
    THIS_MACHINE,
    HostName,
    ListenHost,
    TrackingUrl,
    TrackioProject,
    TrackioUrl,
)


class FigureSettings(Group, title="Live figures for other tools", file="system.env"):
    tensorboard: bool = setting(
        "DR_TENSORBOARD",
        False,
        "Write TensorBoard event files to data/tensorboard; needs the extra tensorboard.",
    )
    telegraf_host: HostName = setting(
        "DR_TELEGRAF_HOST",
        "",
        "Host whose Telegraf takes InfluxDB lines over UDP, for Grafana; empty for none.",
    )
    telegraf_port: int = setting("DR_TELEGRAF_PORT", 8092, "Its UDP port.", between=(1, 65_535))
    prometheus_folder: str = setting(
        "DR_PROMETHEUS_FOLDER",
        "",
        "Folder for a .prom file that node_exporter's textfile collector reads; empty for none.",
    )
    prometheus_port: int = setting(
        "DR_PROMETHEUS_PORT",
        0,
        "Port on which the trainer serves its figures at /metrics; 0 for none.",
        between=(0, 65_535),
    )
    prometheus_host: ListenHost = setting(
        "DR_PROMETHEUS_HOST",
        THIS_MACHINE,
        "Address on which it listens; 0.0.0.0 lets other machines read the figures.",
    )
    mlflow_url: TrackingUrl = setting(
        "DR_MLFLOW_URL", "", "Address of an MLflow server that gets a run; empty for none."
    )
    mlflow_experiment: str = setting(
        "DR_MLFLOW_EXPERIMENT", "deepracer", "Name of the experiment there."
    )
    trackio_url: TrackioUrl = setting(
        "DR_TRACKIO_URL",
        "",
        "Address of a trackio server that gets a run; its token is TRACKIO_WRITE_TOKEN in the "
        "environment. Empty for none.",
    )
    trackio_project: TrackioProject = setting(
        "DR_TRACKIO_PROJECT", "deepracer", "Name of the project there."
    )
