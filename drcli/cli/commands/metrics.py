"""`dr metrics`."""

from typing import Annotated

import typer

from drcli.base.errors import StorageError
from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.options import models_argument
from drcli.cli.show import show
from drcli.cli.stopped_process import show_stopped
from drcli.cli.working_folder import settings, working_folder

with lazy_imports():
    from drcli.run import tensorboard_server
    from drcli.transfer import transfer_buckets


app = typer.Typer(
    no_args_is_help=True,
    help="Start or stop TensorBoard, and show where the figures of trainings go.\n\n"
    "Example: dr-metrics start",
)


@app.command("start")
def start_metrics(
    models: Annotated[
        list[str] | None,
        models_argument("[MODEL]...", "Prefixes of models; that of run.env if left out."),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(
            "--port", metavar="PORT", min=1, max=65_535, help="Where TensorBoard listens; 6006."
        ),
    ] = None,
) -> None:
    """Start TensorBoard, and show where the figures of trainings go.

    Event files of models that another machine trains come from the bucket; give the command again
    for newer ones. Models that were trained without DR_TENSORBOARD get theirs from their history.
    With DR_TENSORBOARD=True, curves of a training on this machine follow within seconds.
    TensorBoard runs in the background, for this machine only, until dr-metrics stop.

    Grafana, Prometheus, MLflow and trackio are not started: the list shows the setting that sends
    figures to yours. Exits 7 if TensorBoard is not installed and no other tool gets figures.

    Example: dr-metrics start
    """
    loaded = settings()
    tensorboard_server.check_tensorboard(loaded)
    prefixes = [loaded.model_prefix] if not models else [name.rstrip("/") for name in models]
    with terminal.waiting("Starting TensorBoard ..."):
        try:
            bucket = transfer_buckets.bucket_to_look_at(loaded.transfer, upload=False)
            fetched = tensorboard_server.fetch_events(loaded, bucket, prefixes)
            written = tensorboard_server.write_histories(loaded, bucket, prefixes)
        except StorageError as error:
            if models:
                raise
            terminal.warn(f"{error} {error.remedy} Only the files on this machine are shown.")
            fetched, written = [], []
        report = tensorboard_server.start_tensorboard(loaded, written, port, fetched)
    show(report)


@app.command("stop")
def stop_metrics() -> None:
    """Stop the TensorBoard that dr-metrics start has started in this folder.

    Does nothing when none is running. Live figures of a running training go on.

    Example: dr-metrics stop
    """
    record = tensorboard_server.stop_tensorboard(working_folder())
    pid = None if record is None else record.pid
    show_stopped("TensorBoard", pid, none="No TensorBoard is running.")
