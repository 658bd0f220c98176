"""Shows what an import made."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.filesize import decimal

from drcli.cli.views.layout import Rows, counted, fitted

if TYPE_CHECKING:
    from drcli.exchange.car_trial import CarTrials
    from drcli.models.imported_model import ImportedModel


@fitted
def imported(columns: int, report: "ImportedModel") -> RenderableType:
    lines = _model(report)
    if report.trials is None:
        return lines
    return Group(lines, "", *_cars(report.trials))


def _model(report: "ImportedModel") -> str:
    would = "Would import" if report.dry_run else "Imported"
    same = f", {len(report.unchanged)} already there" if report.unchanged else ""
    size = f"{counted(len(report.copied), 'file')}, {decimal(report.copied_bytes)}{same}"
    actions = f"{report.num_actions} {report.action_space_type} actions"
    lines = [
        f"{would} {report.source} ({report.form}) to {report.target}: {size}.",
        f"{report.checkpoint}: {report.network}, {actions}, {' and '.join(report.sensors)}.",
    ]
    if report.taken:
        lines.append(f"Taken along: {', '.join(report.taken)}")
    if report.shipped:
        lines.append(f"Missing, so the shipped ones are used: {', '.join(report.shipped)}")
    if report.deleted:
        verb = "would be deleted" if report.dry_run else "deleted"
        lines.append(f"Not part of it and {verb}: {counted(len(report.deleted), 'file')}.")
    lines += [f"Fresh: {text}" for text in report.fresh]
    lines += [f"Verified: {text}" for text in report.verified]
    return "\n".join([*lines, *(f"Wrote {path}" for path in report.custom_files)])


def _cars(trials: "CarTrials") -> list[RenderableType]:
    rows = [
        (
            trial.car,
            f"{trial.laps} of {trial.starts}",
            f"{trial.mean_progress:.1f} %",
            f"{min(trial.lap_times_s):.2f}" if trial.lap_times_s else "-",
            f"{max(trial.lap_times_s):.2f}" if trial.lap_times_s else "-",
        )
        for trial in trials.cars
    ]
    names = ("car", "clean laps", "progress", "fastest s", "slowest s")
    best = next(trial for trial in trials.cars if trial.car == trials.best)
    if not best.laps:
        advice = (
            f"It drives no clean lap on {trials.world}; if it learned another track, try that one "
            "with --world."
        )
    elif trials.best == trials.present:
        advice = f"No car suits it better than that of the settings: DR_SIM_CAR={trials.best}."
    else:
        advice = f"The car that suits it better: write DR_SIM_CAR={trials.best} into run.env."
    title = f"Likeliest actions on {trials.world}:"
    return [title, Rows(names, rows, left=("car",)), advice]
