"""Shows summaries, addresses, stopped runs and speed."""

import time
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drcli.cli.console import BOUNDLESS
from drcli.cli.views.layout import counted, fitted

if TYPE_CHECKING:
    from drcli.records.training_record import DayBudget
    from drcli.run.stopping import StopReport
    from drcli.run.summary import Addresses, Running, Summary
    from drcli.run.worker_processes import SpeedReport

WIDE = 120
_LABEL_WIDTH = 12
Rows = list[tuple[str, RenderableType]]


@fitted
def summary(columns: int, report: "Summary") -> RenderableType:
    left = [("Model", _model_rows(report)), ("Bucket", _bucket_rows(report))]
    right = [("Running", _running_rows(report.running)), ("Machine", _machine_rows(report))]
    head: list[RenderableType] = [Text(report.folder, style="bold")]
    origin = [f"experiment {report.experiment}"] if report.experiment else []
    origin += [f"git branch {report.branch}"] if report.branch else []
    if origin:
        head.append(Text(", ".join(origin), style="dim"))
    if report.budget is not None and (report.budget.limited or report.budget.starts):
        right.insert(1, ("Today", _budget_rows(report.budget)))
    warnings = [Text(f"Warning: {text}", style="yellow") for text in report.warnings]
    if not WIDE <= columns < BOUNDLESS:
        return Group(*head, _column([*left, *right]), *warnings)
    both = Table.grid(padding=(0, 4), expand=True)
    both.add_column(ratio=1)
    both.add_column(ratio=1)
    both.add_row(_column(left), _column(right))
    return Group(*head, both, *warnings)


def addresses(report: "Addresses") -> RenderableType:
    lines: list[RenderableType] = [Text(f"Server: {report.endpoint or 'not started yet'}")]
    for place in report.places:
        lines.append(Text(f"{place.name}:", style="bold"))
        ways = (place.s3, place.http, place.folder)
        lines += [Text(f"  {way}") for way in ways if way is not None]
    return Group(*lines)


def stopped(report: "StopReport") -> str:
    lines = _ended(report)
    if report.server:
        lines.append("Stopped the local S3 server; objects stay.")
    if report.viewer:
        lines.append("Stopped the console.")
    return "\n".join(lines) or "Nothing is running."


def stopped_evaluations(report: "StopReport") -> str:
    return "\n".join(_ended(report)) or "No evaluation is running."


def speed(report: "SpeedReport") -> str:
    if report.steps_per_s is None or report.real_time_factor is None:
        return f"{report.worker} has not finished an iteration yet."
    return (
        f"{report.worker}: {report.steps_per_s:.0f} steps/s, {report.real_time_factor:.0f} x real "
        f"time, in the {report.steps:,} steps of iteration {report.iteration}."
    )


def _ended(report: "StopReport") -> list[str]:
    what = {
        "wait": "wait for the end of the training",
        "worker": "worker for the training",
        "sweep": "sweep",
    }
    return [
        f"Stopped the {what.get(run.kind, run.kind)} of {run.model} "
        f"(run {run.run_id}, process {run.pid})."
        for run in report.stopped
    ]


def _column(groups: "list[tuple[str, Rows]]") -> RenderableType:
    parts: list[RenderableType] = []
    for title, rows in groups:
        table = Table.grid(padding=(0, 1))
        table.add_column(style="dim", width=_LABEL_WIDTH, no_wrap=True)
        table.add_column(overflow="fold")
        for label, value in rows:
            table.add_row(f"  {label}", value)
        parts += [Text(title, style="bold cyan"), table]
    return Group(*parts)


def _model_rows(report: "Summary") -> Rows:
    return [
        ("prefix", Text(report.prefix)),
        ("world", Text(report.world)),
        ("race", Text(report.race_type)),
        ("car", Text(report.car)),
        ("run", Text(f"DR_RUN_ID {report.run_id}, {counted(report.workers, 'worker')}")),
    ]


def _bucket_rows(report: "Summary") -> Rows:
    bucket, prefix = report.bucket, report.prefix
    states = {
        "answers": Text("answers", style="green"),
        "stopped": Text("not running; it starts when needed", style="yellow"),
        "silent": Text(bucket.reason, style="red"),
    }
    model = {
        None: Text("unknown"),
        False: Text(f"{prefix} has no checkpoint yet"),
        True: Text(f"{prefix} is trained up to {bucket.checkpoint}"),
    }
    return [
        ("cloud", Text(f"{bucket.cloud}, s3://{bucket.name}")),
        ("server", Text(bucket.endpoint or "not started yet")),
        ("state", states[bucket.state]),
        ("model", model[bucket.model]),
        *([("best", Text(bucket.best.text))] if bucket.best is not None else []),
    ]


def _running_rows(running: "list[Running]") -> Rows:
    if not running:
        return [("nothing", Text(""))]
    rows: Rows = []
    for run in running:
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(run.since))
        where = f"run {run.run_id}, {run.model} on {run.world}"
        rows.append((run.kind, Text(f"{where}, since {since}, process {run.pid}")))
    return rows


def _budget_rows(budget: "DayBudget") -> Rows:
    hours = f"{budget.hours:.2f}"
    hours += f" of {budget.max_hours:g} hours" if budget.max_hours else " machine hours"
    rows: Rows = [("trained", Text(hours, style="yellow" if budget.used_up else ""))]
    if budget.usd or budget.max_usd:
        money = f"{budget.usd:.2f}" + (f" of {budget.max_usd:g}" if budget.max_usd else "")
        rows.append(("cost", Text(f"{money} USD")))
    return rows


def _machine_rows(report: "Summary") -> Rows:
    versions = ", ".join(f"{name} {value}" for name, value in report.versions.items() if value)
    gpu = ", ".join(report.gpus) or "none; the processor computes everything"
    if report.gpus and not report.gpu_usable:
        gpu += ", which the installed torch cannot use (it is the CPU build)"
    return [("versions", Text(versions)), ("GPU", Text(gpu))]
