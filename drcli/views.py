"""From reports to what people see: tables, curves and sentences, within 80 columns."""

import time
from itertools import pairwise
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from drcli.runs.report import EvaluationReport, IterationRecord, RunReport
    from drcli.runs.training import RunPlan

BLOCKS = " ▁▂▃▄▅▆▇█"
CURVE_WIDTH = 60
ROWS = 6
"""Iterations in the table of the live display."""

STATE_STYLES = {
    "running": "green",
    "starting": "cyan",
    "finished": "bold green",
    "stopped": "yellow",
    "failed": "bold red",
    "lost": "bold red",
}


def curve(values: list[float], top: float | None = None, width: int = CURVE_WIDTH) -> str:
    """A curve one line high.

    Args:
        values: Oldest first; longer lists are averaged down to the width.
        top: The value that fills a character; the greatest one if left out.
        width: Characters at most.
    """
    if not values:
        return ""
    if len(values) > width:
        edges = [round(i * len(values) / width) for i in range(width + 1)]
        values = [sum(values[a:b]) / (b - a) for a, b in pairwise(edges)]
    low = min(0.0, *values)
    span = (top if top is not None else max(values)) - low
    if span <= 0:
        return BLOCKS[1] * len(values)
    last = len(BLOCKS) - 1
    return "".join(BLOCKS[max(1, min(last, round((v - low) / span * last)))] for v in values)


def live(report: "RunReport", began: float) -> RenderableType:
    """The display that follows a training; always of the same height."""
    records = report.history
    head = Text.assemble(
        (report.state, STATE_STYLES.get(report.state, "")),
        f"  s3://{report.bucket}/{report.prefix}  on {report.world}",
    )
    last = records[-1] if records else None
    facts = f"{_clock(time.time() - (report.started_at or began))}   " + (
        f"iteration {last.iteration + 1}   {last.total_steps:,} steps   "
        f"{last.steps_per_s:.0f} steps/s   {last.real_time_factor:.0f} x real time"
        if last
        else "the first iteration is being driven"
    )
    waits = "   ".join(f"{w.name} {w.activity}" for w in report.workers[:3])
    body: list[RenderableType] = [
        head,
        Text(facts),
        Text(waits, style="dim", overflow="ellipsis", no_wrap=True),
        _iterations(records[-ROWS:], ROWS),
        Text(f"progress {curve([r.mean_progress for r in records], 100.0)}", style="green"),
        Text(f"reward   {curve([r.mean_reward for r in records])}", style="cyan"),
        Text(_best(report)),
        Text("Ctrl-C leaves this display, training goes on; dr-stop-training stops it.", "dim"),
    ]
    return Group(*body)


def run(report: "RunReport") -> RenderableType:
    """Everything `dr status` has to say."""
    if report.state == "none":
        return Text("Nothing was started in this folder yet. Start with `dr-start-training`.")
    head = Text.assemble(
        f"Run {report.run_id}: ",
        (report.state, STATE_STYLES.get(report.state, "")),
        f"  s3://{report.bucket}/{report.prefix}  on {report.world}",
    )
    parts: list[RenderableType] = [head]
    if report.message:
        parts.append(Text(report.message))
    for worker in report.workers:
        if report.state in ("running", "starting"):
            alive = "alive" if worker.alive else "DEAD"
            again = f", restarted {worker.restarts} x" if worker.restarts else ""
            parts.append(
                Text(f"  {worker.name} ({alive}, process {worker.pid}{again}): {worker.activity}")
            )
    if report.history:
        last = report.history[-1]
        parts += [
            _iterations(report.history[-10:], 0),
            Text(f"progress {curve([r.mean_progress for r in report.history], 100.0)}"),
            Text(f"reward   {curve([r.mean_reward for r in report.history])}"),
            Text(
                f"{last.total_steps:,} steps in {_clock(last.elapsed_s)}, "
                f"{sum(r.full_laps for r in report.history)} full training laps."
            ),
            Text(_best(report)),
        ]
    return Group(*parts)


def evaluation(report: "EvaluationReport") -> RenderableType:
    """The trials of an evaluation, and the sentence that sums them up."""
    table = Table(box=None, pad_edge=False)
    for name in ("trial", "progress", "time", "status", "off track", "resets"):
        table.add_column(name, justify="left" if name == "status" else "right")
    for trial in report.trials:
        table.add_row(
            str(trial.trial),
            f"{trial.progress:.0f} %",
            f"{trial.lap_s:.2f} s",
            trial.status,
            str(trial.off_track),
            str(trial.resets),
        )
    best = f", best lap {report.best_lap_s:.2f} s" if report.best_lap_s is not None else ""
    return Group(
        table,
        Text(
            f"{report.completed} of {len(report.trials)} laps completed{best}. "
            f"Checkpoint {report.checkpoint} of {report.prefix} on {report.world}.",
            style="bold",
        ),
    )


def iteration_line(record: "IterationRecord") -> str:
    """One iteration in one line, for logs and pipes."""
    laps = f"{record.full_laps}/{record.episodes} laps"
    return (
        f"iteration {record.iteration:3d}  {record.total_steps:7d} steps  "
        f"reward {record.mean_reward:7.1f}  progress {record.mean_progress:5.1f} %  {laps}  "
        f"evaluation {_evaluated(record)}  entropy {record.entropy:.2f}  "
        f"{record.steps_per_s:.0f} steps/s  {_clock(record.elapsed_s)}"
    )


def start_text(plan: "RunPlan") -> str:
    """What is going to be trained, from what."""
    settings, inputs = plan.job.settings, plan.inputs
    begin = f"Resuming {plan.resumes}" if plan.resumes else "Training"
    return "\n".join(
        [
            f"{begin} of model s3://{settings.bucket}/{settings.model_prefix} starting "
            f"on {settings.world_name} (seed {plan.job.seed}).",
            "Using configuration files:",
            *(
                f"   {file.origin}"
                for file in (inputs.reward, inputs.hyperparameters, inputs.metadata)
            ),
        ]
    )


def end_text(report: "RunReport") -> str:
    """How a training ended."""
    best = f" Best checkpoint: {report.best.name}." if report.best else ""
    return f"{report.message}{best} {report.remedy}".strip()


def _iterations(records: "list[IterationRecord]", rows: int) -> Table:
    """The newest iterations, filled up to a fixed number of rows."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("iter", "steps", "reward", "progress", "laps", "eval", "entropy", "loss p/v"):
        table.add_column(name, justify="right", no_wrap=True)
    for record in records:
        table.add_row(
            str(record.iteration),
            f"{record.total_steps:,}",
            f"{record.mean_reward:.1f}",
            f"{record.mean_progress:.1f} %",
            f"{record.full_laps}/{record.episodes}",
            _evaluated(record),
            f"{record.entropy:.2f}",
            f"{record.surrogate_loss:.3f}/{record.value_loss:.2f}",
        )
    for _ in range(rows - len(records)):
        table.add_row()
    return table


def _evaluated(record: "IterationRecord") -> str:
    progress = record.evaluation_progress
    if not progress:
        return "..."
    return f"{sum(progress) / len(progress):.0f} % {len(record.evaluation_lap_s)}/{len(progress)}"


def _best(report: "RunReport") -> str:
    best, last = report.best, report.last
    if best is None or last is None:
        return "No checkpoint yet."
    metric = f" ({best.metric:.1f})" if best.metric is not None else ""
    return f"best {best.name}{metric}   last {last.name}"


def _clock(seconds: float) -> str:
    whole = int(seconds)
    hours, rest = divmod(whole, 3600)
    minutes, left = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{left:02d}" if hours else f"{minutes}:{left:02d}"
