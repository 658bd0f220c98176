"""`dr sweep`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.live import Live
from rich.text import Text

from drcli.base.errors import SettingsError
from drcli.base.files import refuse_existing, refuse_replacing, rewrite
from drcli.base.installation import lazy_imports
from drcli.cli import console, prompts
from drcli.cli.fetch_tracks import bring_tracks
from drcli.cli.options import DryRun, Force, Replace, text_only, wipe_option
from drcli.cli.views.layout import Rows, counted
from drcli.cli.working_folder import settings, working_folder
from drcli.config.presets import model_file

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.sweeps.start_sweep import SweepPlanned
    from drcli.sweeps.sweep_report import SweepList, SweepReport, TrialReport

with lazy_imports():
    from drcli.config import loading
    from drcli.sweeps import start_sweep, stored_sweep, sweep_report
    from drcli.transfer import transfer_buckets


# Shows sweeps.


_STYLES = {
    "running": "green",
    "failed": "red",
    "paused": "dim",
    "waiting": "dim",
    "stopped early": "dim",
}


def sweep(report: "SweepReport") -> RenderableType:
    over = sum(trial.state not in ("waiting", "running", "paused") for trial in report.trials)
    state = "ended" if report.ended else f"{over} of {len(report.trials)} over"
    head = Text.assemble(
        (f"Sweep {report.name}", "bold"),
        f" ({state}), best {report.metric.replace('_', ' ')} first, "
        f"{report.most:,.12g} {report.resource if report.most != 1 else report.resource[:-1]} each",
    )
    varied = list(dict.fromkeys(key for trial in report.trials for key in trial.varied))
    results = ("clean laps", "progress", "median clean lap")
    names = ["", "training", *varied, "state", report.resource, *results]
    rows: list[list[str | Text]] = [
        [
            Text("*" if trial.best else "", style="bold"),
            trial.name,
            *(trial.varied.get(key, "") for key in varied),
            Text(trial.state, style=_STYLES.get(trial.state, "")),
            _amount(report, trial),
            f"{trial.laps}/{trial.episodes}" if trial.episodes else "-",
            "-" if trial.progress is None else f"{trial.progress:.0f} %",
            "-" if trial.lap_s is None else f"{trial.lap_s:.2f} s",
        ]
        for trial in report.trials
    ]
    parts: list[RenderableType] = [head, Rows(names, rows, left=["", "training", *varied, "state"])]
    parts += [
        Text(f"{trial.name}: {trial.message} {trial.remedy}".rstrip())
        for trial in report.trials
        if trial.state == "failed"
    ]
    if report.best:
        word = "best" if report.ended else "best so far"
        parts.append(Text(f"* {word}; its model is {_best(report).model}"))
    elif report.ended:
        parts.append(Text("None is the best: no training was evaluated."))
    if report.comparison is not None:
        parts.append(Text(f"Comparison: {report.comparison}"))
    return Group(*parts)


def sweeps(found: "SweepList") -> RenderableType:
    if not found.sweeps:
        return Text(f"s3://{found.bucket} has no sweeps. `dr-sweep init` writes an example.")
    rows = [
        [
            each.name,
            "ended" if each.ended else "not ended",
            str(len(each.trials)),
            each.best,
            _best(each).model if each.best else "",
        ]
        for each in found.sweeps
    ]
    names = ["sweep", "state", "trainings", "best", "model"]
    return Rows(names, rows, left=["sweep", "state", "best", "model"])


def planned(plan: "SweepPlanned") -> RenderableType:
    varied = list(dict.fromkeys(key for trial in plan.trials.values() for key in trial))
    rows = [[name, *(trial.get(key, "") for key in varied)] for name, trial in plan.trials.items()]
    verb = "continues" if plan.continues else "has"
    text = f"{verb} {counted(len(plan.trials), 'training')}, {at_a_time(plan)}."
    head = Text.assemble((f"Sweep {plan.name}", "bold"), f" {text}")
    return Group(head, Rows(["training", *varied], rows, left=["training", *varied]))


def at_a_time(plan: "SweepPlanned") -> str:
    return (
        "as many at a time as Ray has room for"
        if plan.parallel is None
        else (f"{plan.parallel} at a time")
    )


def _best(report: "SweepReport") -> "TrialReport":
    return next(trial for trial in report.trials if trial.best)


def _amount(report: "SweepReport", trial: "TrialReport") -> str:
    return f"{trial.amount:.1f}" if report.resource == "minutes" else f"{trial.amount:,.0f}"


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
    with console.waiting("Checking the sweep ...", only_live=True):
        begun = start_sweep.SweepStart(loaded, file)
    plan = begun.planned(parallel)
    if dry_run:
        console.emit(plan, planned(plan))
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
    console.say(
        f"Sweep {plan.name}: {len(plan.trials)} trainings, {at_a_time(plan)}. Ctrl-C interrupts it."
    )
    with _live() as show:
        report = begun.run(parallel=parallel, say=console.say, warn=console.warn, on_change=show)
    page = start_sweep.comparison_page(loaded.directory, plan.name) if html is None else html
    with console.waiting("Comparing the trainings ...", only_live=True):
        report, problem = start_sweep.try_to_compare(begun, report, page)
    if problem:
        console.warn(problem)
    console.emit(report, sweep(report))
    if report.best:
        best = next(trial for trial in report.trials if trial.best)
        console.suggest(
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
    console.warn(*found.damaged)
    console.emit(found, sweeps(found))


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
    report = sweep_report.report_of(record, bucket.name)
    console.emit(report, sweep(report))


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
    console.say(f"Wrote {path}.")
    console.suggest([(f"dr-sweep {path.name}", "start it once you have changed it")])


def _own_settings() -> "Settings":
    settings()  # says what is wrong with DR_DIR
    return loading.load_settings(working_folder(), flags={"DR_EXPERIMENT_NAME": ""})


@contextmanager
def _live() -> Iterator[Callable[["SweepReport"], None]]:
    if not console.is_live():
        yield lambda report: None
        return

    with Live(console=console.err, refresh_per_second=2, transient=True) as display:
        yield lambda report: display.update(sweep(report))
