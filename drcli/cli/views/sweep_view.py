"""Shows sweeps."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows, counted

if TYPE_CHECKING:
    from drcli.sweeps.start_sweep import SweepPlanned
    from drcli.sweeps.sweep_report import SweepList, SweepReport, TrialReport

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
