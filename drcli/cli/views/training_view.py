"""How a training looks: a live display, its state, what is said at its start and end."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views import iterations
from drcli.cli.views.layout import counted, fitted, indented

if TYPE_CHECKING:
    from drcli.exchange.training_start import Pretrained
    from drcli.runs.increment import Increment
    from drcli.runs.plan import EndWorkPlan, RunPlan
    from drcli.runs.spending_report import RequestReport
    from drcli.runs.status import RunReport, WorkerReport

LIVE_ROWS = 6
"""Iterations in the table of the live display."""

STATUS_ROWS = 10
"""Iterations in the table of `dr status`."""

FOOTER = "Ctrl-C leaves this display; dr-stop-training stops the training."

STATE_STYLES = {
    "running": "green",
    "starting": "cyan",
    "finished": "bold green",
    "stopped": "yellow",
    "interrupted": "bold yellow",
    "failed": "bold red",
    "lost": "bold red",
}


@fitted
def live(
    columns: int, report: "RunReport", now_s: float, *, verbose: bool = False
) -> RenderableType:
    """The display that follows a training; `now_s` is the time in Unix seconds.

    Lines are cut at the edge of the terminal, and missing ones are left empty: the height never
    changes. `verbose` adds a line for each worker, and the time that each step took.
    """
    parts: list[RenderableType] = [_head(report), Text(_pace(report, now_s))]
    if verbose:
        parts += [Text(f"{worker.name}: {worker.activity}") for worker in report.workers]
        parts.append(Text(_time_split(report)))
    else:
        activities = (f"{w.name} {w.activity}" for w in report.workers if w.activity)
        parts.append(Text("   ".join(activities), style="dim"))
    parts += [
        iterations.table(report.history[-LIVE_ROWS:], LIVE_ROWS, columns),
        *iterations.curves(report.history, columns),
    ]
    # A warning names the best checkpoint too, so it replaces the line about checkpoints.
    parts.append(_warning(report) if report.warning else Text(_checkpoints(report)))
    parts.append(Text(FOOTER if report.state in ("starting", "running") else "", style="dim"))
    for part in parts:
        if isinstance(part, Text):
            part.no_wrap, part.overflow = True, "ellipsis"
    return Group(*parts)


@fitted
def run(columns: int, report: "RunReport") -> RenderableType:
    """The page of `dr status`."""
    if report.state == "none":
        return Text("Nothing was started here yet. Start with `dr-start-training`.")
    parts: list[RenderableType] = [Text.assemble(f"Run {report.run_id}: ", _head(report))]
    if report.message:
        parts.append(Text(report.message))
    if report.state in ("failed", "interrupted") and report.remedy:
        parts.append(indented(f"Try: {report.remedy}"))
    if report.state in ("starting", "running"):
        parts += [indented(_worker(worker)) for worker in report.workers]
        if limits := _limits(report):
            parts.append(indented(limits))
    parts += [Text(f"Warning: {text}", style="bold yellow") for text in report.watches]
    if report.history:
        last = report.history[-1]
        laps = sum(record.full_laps for record in report.history)
        parts += [
            iterations.table(report.history[-STATUS_ROWS:], 0, columns),
            *iterations.curves(report.history, columns),
            Text(
                f"{last.total_steps:,} steps in {iterations.clock(report.elapsed_s)}, "
                f"{last.steps_per_s:.0f} steps/s, {last.real_time_factor:.0f} x real time, "
                f"{laps} full training laps."
            ),
            Text(_checkpoints(report)),
        ]
        if report.warning:
            parts.append(_warning(report))
    parts += [Text(line) for line in (_spent(report), _left(report), _requests(report)) if line]
    return Group(*parts)


def _limits(report: "RunReport") -> str:
    """How much of the processor the run leaves to others; empty where it takes all it can get."""
    parts = ["low priority (DR_PRIORITY)"] if report.priority == "low" else []
    if report.threads:
        parts.append(f"at most {counted(report.threads, 'core')} (DR_THREADS)")
    return f"processor: {', '.join(parts)}" if parts else ""


def _spent(report: "RunReport") -> str:
    """Iterations, machine hours and money until now."""
    spending = report.spending
    if spending is None:
        return ""
    starts = counted(spending.starts, "start")
    text = f"Spent: {counted(report.iterations, 'iteration')}, {spending.hours:.2f} machine hours "
    text += f"in {starts}"
    if spending.usd is not None:
        text += f", {spending.usd:.4g} USD"
        if spending.usd_per_hour is not None:
            text += f" ({spending.usd_per_hour:.4g} USD per hour, {spending.price_of})"
        if spending.unpriced_hours:
            text += f"; the price of {spending.unpriced_hours:.2f} hours is not known"
    if spending.damaged:
        text += f"; the cost of {counted(len(spending.damaged), 'start')} is lost"
    return f"{text}."


def _left(report: "RunReport") -> str:
    """What the limits still allow."""
    if report.state not in ("starting", "running"):
        return ""
    parts = []
    if report.iterations_left is not None:
        parts.append(counted(report.iterations_left, "iteration"))
    if report.time_left_s is not None:
        parts.append(iterations.clock(report.time_left_s))
    if report.money_left is not None and report.spending is not None:
        money = f"{report.money_left:.4g} of {report.spending.max_usd:.4g} USD"
        price = report.spending.usd_per_hour
        if price:
            money += f" (for {report.money_left / price:.2f} machine hours)"
        parts.append(money)
    return f"Left: {', '.join(parts)}." if parts else ""


def _requests(report: "RunReport") -> str:
    """Requests per hour, and what a night of them costs."""
    made = report.requests
    if made is None:
        return ""
    sent, received = (f"{size / made.hours / 1e6:,.0f} MB" for size in _traffic(made))
    return (
        f"Bucket, per hour: {made.puts / made.hours:,.0f} requests that write or list, "
        f"{made.gets / made.hours:,.0f} that read, {sent} sent, {received} received; a night of "
        f"10 hours at Amazon's list prices: {made.night_usd:.2f} USD."
    )


def _traffic(made: "RequestReport") -> tuple[int, int]:
    return made.sent_bytes, made.received_bytes


def start_text(plan: "RunPlan") -> str:
    """What will be trained, and from which files and weights."""
    config, inputs = plan.job.config, plan.inputs
    workers = counted(config.train.workers, "worker")
    begin = f", resuming from {plan.resumes}" if plan.resumes else ""
    if plan.pretrained is not None:
        begin = f", with the weights of {_source(plan.pretrained)}"
    model = f"s3://{config.storage.bucket}/{config.model.prefix}"
    lines = [f"Wiping path {model}"] if plan.wiped else []
    lines += [
        f"Training of model {model} starting{begin}.",
        f"World {config.race().world_name}, {workers}, seed {plan.job.seed}.",
        "Using configuration files:",
        *(f"   {f.origin}" for f in (inputs.reward, inputs.hyperparameters, inputs.metadata)),
        plan.ends,
    ]
    return "\n".join(lines)


def end_work_text(plan: "EndWorkPlan") -> str:
    """What is left to do for a complete training."""
    config = plan.job.config
    model = f"s3://{config.storage.bucket}/{config.model.prefix}"
    return (
        f"{model}: {plan.outcome.message} What was left to do at its end is done now: "
        f"{', '.join(plan.outcome.left)}."
    )


def increment(step: "Increment") -> RenderableType:
    """From which weights the new model will start."""
    return Text(f"{step.after} starts with the weights of {_source(step.pretrained)}.")


def end_text(report: "RunReport") -> str:
    """How a training ended."""
    best = f" Best checkpoint: {report.best.name}." if report.best else ""
    return f"{report.message}{best} {report.remedy}".strip()


def _worker(worker: "WorkerReport") -> str:
    """A line about a worker."""
    if worker.pid is None:
        return f"{worker.name}: not started, or left out"
    state = f"{'alive' if worker.alive else 'DEAD'}, process {worker.pid}"
    state += f", restarted {worker.restarts} x" if worker.restarts else ""
    health = f" ({worker.health.words(worker.name)})" if worker.health and worker.alive else ""
    return f"{worker.name} ({state}): {worker.activity}{health}"


def _source(pretrained: "Pretrained") -> str:
    return f"{pretrained.prefix} ({pretrained.checkpoint} checkpoint {pretrained.name})"


def _warning(report: "RunReport") -> Text:
    return Text(f"Warning: {report.warning}", style="bold yellow")


def _head(report: "RunReport") -> Text:
    return Text.assemble(
        (report.state, STATE_STYLES.get(report.state, "")),
        f"  s3://{report.bucket}/{report.prefix}  on {report.world}",
    )


def _pace(report: "RunReport", now_s: float) -> str:
    """How long and how fast it trains."""
    clock = iterations.clock(now_s - report.started_at) if report.started_at else "0:00"
    if not report.history:
        return f"{clock}   driving the first iteration"
    last = report.history[-1]
    return (
        f"{clock}   iteration {last.iteration + 1}   {last.total_steps:,} steps   "
        f"{last.steps_per_s:.0f} steps/s   {last.real_time_factor:.0f} x real time"
    )


def _time_split(report: "RunReport") -> str:
    if not report.history:
        return ""
    last = report.history[-1]
    times = iterations.time_split(last)
    return f"iteration {last.iteration} took: {times}   {iterations.last_step(last)}"


def _checkpoints(report: "RunReport") -> str:
    best, last = report.best, report.last
    if best is None or last is None:
        return "No checkpoint yet."
    metric = f" ({best.metric:.1f})" if best.metric is not None else ""
    return f"best {best.name}{metric}   last {last.name}"
