"""`dr sweep`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.live import Live

from drcli.base.errors import SettingsError
from drcli.base.files import refuse_existing, refuse_replacing, rewrite
from drcli.base.installation import lazy_imports
from drcli.cli import prompts, terminal
from drcli.cli.fetch_tracks import bring_tracks
from drcli.cli.options import DryRun, Force, Replace, text_only, wipe_option
from drcli.cli.show import drawn
from drcli.cli.show import show as present
from drcli.cli.working_folder import settings, working_folder
from drcli.config.presets import model_file

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.sweeps.sweep_report import SweepReport

with lazy_imports():
    from drcli.config import loading
    from drcli.sweeps import start_sweep, stored_sweep, sweep_report
    from drcli.transfer import transfer_buckets


# Writes an example sweep file.


def write_example(path: Path, *, force: bool = False) -> Path:
    """Raises SettingsError for an existing file without `force`, or an unwritable one."""
    refuse_existing(path, force=force)
    if not path.parent.is_dir():
        raise SettingsError(f"{path.parent} is not a folder.", remedy="Create it first.")
    rewrite(path, model_file("sweep.yaml").read_bytes())
    return path


EXAMPLE = "sweep.yaml"

app = typer.Typer(
    no_args_is_help=True,
    help="Train several models that differ in reward function, hyperparameters or other things."
    "\n\nA file says what differs, how long each training may take, and which of them end early. "
    "`dr-sweep FILE` is short for `dr-sweep start FILE`.\n\n"
    "Example: dr-sweep init, then dr-sweep sweep.yaml",
)


@app.command()
def start(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File of the sweep.")],
    wipe: Annotated[
        bool, wipe_option("Delete the models of an earlier sweep of this name.")
    ] = False,
    parallel: Annotated[
        int | None,
        typer.Option("--parallel", min=1, max=100, metavar="N", help="Trainings at a time."),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html", metavar="PAGE", help="Where to write the comparison; NAME-comparison.html."
        ),
    ] = None,
    force: Force = False,
    dry_run: DryRun = False,
) -> None:
    """Start a sweep, or continue it.

    Each training is an experiment in experiments/, with a model of the same name:
    `DR_EXPERIMENT_NAME=first-sweep-01 dr-status` and all other commands work for it. The command
    ends when all trainings are over; it then compares them and marks the best. A training that
    fails does not stop the others.

    Ctrl-C and SIGTERM interrupt the trainings; the same command continues them. Started again
    after its end, it tries again what has failed.

    Example: dr-sweep start sweep.yaml
    """
    loaded = _own_settings()
    with terminal.waiting("Checking the sweep ...", only_live=True):
        begun = start_sweep.SweepStart(loaded, file)
    plan = begun.planned(parallel)
    if dry_run:
        present(plan)
        return
    if html is not None and not plan.continues:  # a sweep that goes on updates its page
        refuse_replacing(html, force=force)
    if wipe and plan.continues:
        question = f"Delete the sweep {plan.name} and all its models?"
        prompts.agree(question, yes=force)
        begun.wipe()
        plan = begun.planned(parallel)
    for world in begun.worlds:
        bring_tracks(loaded.replaced(world_name=world))
    count = f"{len(plan.trials)} trainings, {plan.at_a_time()}"
    terminal.say(f"Sweep {plan.name}: {count}. Ctrl-C interrupts it.")
    with _live() as show:
        report = begun.run(parallel=parallel, say=terminal.say, warn=terminal.warn, on_change=show)
    page = start_sweep.comparison_page(loaded.directory, plan.name) if html is None else html
    with terminal.waiting("Comparing the trainings ...", only_live=True):
        report, problem = start_sweep.try_to_compare(begun, report, page)
    if problem:
        terminal.warn(problem)
    present(report)
    if report.best:
        best = next(trial for trial in report.trials if trial.best)
        terminal.suggest(
            [
                (f"DR_EXPERIMENT_NAME={best.name} dr-evaluate", "drive the best"),
                (f"dr-increment-training --pretrained {best.model}", "train it further"),
            ]
        )
    if all(trial.state == "failed" for trial in report.trials):
        raise typer.Exit(5)


@app.command("list")
def list_all() -> None:
    """List the sweeps of the bucket, the newest first.

    Example: dr-sweep list
    """
    found = sweep_report.list_sweeps(
        transfer_buckets.bucket_to_look_at(settings().transfer, upload=False)
    )
    terminal.warn(*found.damaged)
    present(found)


@app.command()
def show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the sweep.")],
) -> None:
    """Show the trainings of a sweep, the best first.

    Example: dr-sweep show first-sweep
    """
    bucket = transfer_buckets.bucket_to_look_at(settings().transfer, upload=False)
    record = stored_sweep.read_sweep(bucket, name)
    if record is None:
        raise SettingsError(
            f"s3://{bucket.name} has no sweep {name}.", remedy="List them with `dr-sweep list`."
        )
    present(sweep_report.report_of(record, bucket.name))


@app.command()
@text_only
def init(
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE", help=f"Where to write it; {EXAMPLE}.")
    ] = None,
    force: Replace = False,
) -> None:
    """Write an example of the file of a sweep.

    Example: dr-sweep init
    """
    path = write_example(file or working_folder() / EXAMPLE, force=force)
    terminal.say(f"Wrote {path}.")
    terminal.suggest([(f"dr-sweep {path.name}", "start it once you have changed it")])


def _own_settings() -> "Settings":
    settings()  # says what is wrong with DR_DIR
    return loading.load_settings(working_folder(), flags={"DR_EXPERIMENT_NAME": ""})


@contextmanager
def _live() -> Iterator[Callable[["SweepReport"], None]]:
    if not terminal.is_live():
        yield lambda report: None
        return

    with Live(console=terminal.err, refresh_per_second=2, transient=True) as display:
        yield lambda report: display.update(drawn(report))
