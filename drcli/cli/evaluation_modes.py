"""The modes of `dr evaluate` that drive more than one evaluation."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drcli.cli import console
from drcli.cli.fetch_tracks import bring_tracks
from drcli.cli.views import evaluation_tables
from drcli.exchange.policy_source import PolicySource

if TYPE_CHECKING:
    from drcli.config.settings import Settings


@dataclass(frozen=True)
class Many:
    """What the options ask for.

    Attributes:
        models: Prefixes, maybe with wildcards; empty for the model of the settings.
        worlds: Tracks; empty for that of the settings.
        robust: Whether to drive the grid of disturbances.
        seed: Of all random numbers.
        own: What drives instead of a checkpoint.
    """

    models: list[str]
    worlds: list[str]
    robust: bool
    seed: int | None
    own: PolicySource


def evaluate_many(settings: "Settings", asked: Many, *, quiet: bool, as_json: bool) -> None:
    """Drive all models on all tracks, and show the table; of a single grid, the grid."""
    from drcli.base.errors import WorkerDied
    from drcli.runs.many_evaluations import run_many
    from drcli.runs.many_evaluations_plan import on_world, prepare_many

    for world in asked.worlds or [settings.world_name]:
        bring_tracks(on_world(settings, world))
    say = _say(quiet=quiet)
    plan = prepare_many(
        settings,
        models=asked.models,
        worlds=asked.worlds,
        robust=asked.robust,
        seed=asked.seed,
        own=asked.own,
        on_progress=say,
    )
    report = run_many(plan, say)
    console.warn(*report.notes)
    if asked.robust and len(report.rows) == 1 and report.robust:
        found = report.robust[0]
        console.emit(found, evaluation_tables.robust_grid(found), as_json=as_json)
        return
    console.emit(report, evaluation_tables.models_table(report), as_json=as_json)
    if all(row.reason for row in report.rows):
        raise WorkerDied(
            "None of these models could be evaluated.", remedy="Read the reasons in the table."
        )


def evaluate_in_a_loop(
    settings: "Settings", seed: int | None, *, quiet: bool, as_json: bool
) -> None:
    """Evaluate until Ctrl-C or dr-stop-evaluation, and show the table of best laps."""
    from drcli.runs.evaluation_loop import run_loop

    say = _say(quiet=quiet)
    say("Evaluating each new checkpoint until Ctrl-C or dr-stop-evaluation.")
    report = run_loop(settings, seed=seed, on_progress=say, on_failure=console.warn)
    console.emit(report, evaluation_tables.best_laps(report), as_json=as_json)


def _say(*, quiet: bool) -> Callable[[str], None]:
    return (lambda text: None) if quiet else console.say
