"""`dr evaluate`, also called `dr-start-evaluation`."""

from dataclasses import dataclass
from typing import Annotated

import typer

from drcli.cli import console
from drcli.cli.fetch_tracks import bring_tracks
from drcli.cli.options import AsJson
from drcli.cli.views import evaluation_view
from drcli.cli.working_folder import settings

STARTER = "start-evaluation"
"""Under this name -q returns at once, as scripts for DeepRacer-for-Cloud expect."""


LOG = ("dr-logs evaluation -a", "show its whole log")
RESUME = ("dr-start-training --resume", "continue training")
STATUS = ("dr-status", "show how the training went")


@dataclass(frozen=True)
class Started:
    """An evaluation that runs in the background.

    Attributes:
        prefix: Model prefix.
        checkpoint: Name of the checkpoint that drives.
        pid: Process that supervises it.
        simtrace: Key of its trace in the bucket, once it has ended.
        metrics: Key of its metrics.
    """

    prefix: str
    checkpoint: str
    pid: int
    simtrace: str
    metrics: str


def evaluate(
    context: typer.Context,
    quiet: Annotated[
        bool,
        typer.Option(
            "-q",
            "--quiet",
            help="Print only the result. dr-start-evaluation -q runs in the background.",
        ),
    ] = False,
    clone: Annotated[
        bool, typer.Option("-c", "--clone", help="Evaluate a copy at <prefix>-E.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Drive evaluation laps with the model and report the result.

    DR_EVAL_CHECKPOINT chooses the best or the last checkpoint; the other DR_EVAL_ settings describe
    the laps. The model is not changed, so it may be training at the same time.

    dr-start-evaluation -q drives in the background: results are written to the bucket, messages to
    the log, and dr-stop-evaluation stops it.

    Example: dr-evaluate --json
    """
    from drcli.runs import evaluation, stopping
    from drcli.runs.evaluation_plan import prepare_evaluation

    loaded = settings()
    bring_tracks(loaded)
    if quiet and context.info_name == STARTER:
        plan = prepare_evaluation(loaded, clone=clone, on_progress=console.say)
        record = evaluation.launch_evaluation(plan)
        started = Started(record.prefix, record.checkpoint, record.pid, plan.simtrace, plan.metrics)
        console.emit(started, None, as_json=as_json)
        return
    say = (lambda text: None) if quiet else console.say
    report = evaluation.evaluate(loaded, clone=clone, on_progress=say)
    console.emit(report, evaluation_view.evaluation(report), as_json=as_json)
    if not quiet:
        resume = [] if stopping.is_running(loaded.run) else [RESUME]
        console.suggest([LOG, *resume, STATUS])
