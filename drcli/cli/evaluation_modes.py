"""Modes of `dr evaluate` with more than one evaluation."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer

from drcli.cli import console
from drcli.cli.fetch_tracks import bring_tracks
from drcli.cli.views import evaluation_tables, laps_view
from drcli.exchange.policy_source import PolicySource

if TYPE_CHECKING:
    from drcli.config.settings import Settings


@dataclass(frozen=True)
class Many:
    """What the options ask for.

    Attributes:
        models: Prefixes or wildcards; empty: the settings', as with `worlds`.
        robust: Drive the grid of disturbances.
        fresh_laps: Laps from fresh starts instead of the trials.
        against: As `Rival.parse` reads it.
    """

    models: list[str]
    worlds: list[str]
    robust: bool
    seed: int | None
    own: PolicySource
    fresh_laps: int = 0
    against: str = ""


def evaluate_many(settings: "Settings", asked: Many, *, quiet: bool, as_json: bool) -> None:
    """Drive all models on all tracks, and show the table.

    Raises:
        typer.BadParameter: The other side of a comparison cannot be read.
    """
    from drcli.base.errors import WorkerDied
    from drcli.base.problems import BadValue, shown
    from drcli.runs.many_evaluations import run_many
    from drcli.runs.many_evaluations_plan import Rival, on_world, prepare_many

    try:
        rival = Rival.parse(asked.against) if asked.against else None
    except BadValue as error:
        raise typer.BadParameter(
            f"--against {shown(asked.against)} {error.reason}. {error.remedy}"
        ) from None
    for world in asked.worlds or [settings.world_name]:
        bring_tracks(on_world(settings, world))
    say = _say(quiet=quiet)
    plan = prepare_many(
        settings,
        models=asked.models,
        worlds=asked.worlds,
        robust=asked.robust,
        fresh_laps=asked.fresh_laps,
        rival=rival,
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
    if len(report.laps) == 1 and not any(row.reason for row in report.rows):
        sample = report.laps[0]
        console.emit(sample, laps_view.laps(sample), as_json=as_json)
        return
    console.emit(report, evaluation_tables.models_table(report), as_json=as_json)
    if all(row.reason for row in report.rows):
        raise WorkerDied(
            "None of these models could be evaluated.", remedy="Read the reasons in the table."
        )


def evaluate_in_a_loop(
    settings: "Settings", seed: int | None, *, quiet: bool, as_json: bool
) -> None:
    from drcli.runs.evaluation_loop import run_loop

    say = _say(quiet=quiet)
    say("Evaluating each new checkpoint until Ctrl-C or dr-stop-evaluation.")
    report = run_loop(settings, seed=seed, on_progress=say, on_failure=console.warn)
    console.emit(report, evaluation_tables.best_laps(report), as_json=as_json)


def _say(*, quiet: bool) -> Callable[[str], None]:
    return (lambda text: None) if quiet else console.say
