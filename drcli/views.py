"""From reports to what people see: tables, curves and sentences, within 80 columns."""

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drcli import sparkline

if TYPE_CHECKING:
    from drcli.runs.increment import Increment
    from drcli.runs.plan import RunPlan
    from drcli.runs.pretrained import Pretrained
    from drcli.runs.report import EvaluationReport, IterationRecord, RunReport
    from drcli.tracks.facts import TrackFacts, TrackList
    from drcli.tracks.folder import TrackView

CURVE_WIDTH = 54
"""Characters of a curve; its name and its newest value stand beside it."""

LIVE_ROWS = 6
"""Iterations in the table of the live display."""

STATUS_ROWS = 10
"""Iterations in the table of `dr status`."""

ITERATION_COLUMNS = {
    "iter": 4,
    "steps": 9,
    "reward": 7,
    "progress": 8,
    "laps": 6,
    "eval": 9,
    "entropy": 7,
    "loss p/v": 12,
}
"""Least widths, so that columns stay where they are while numbers grow."""

FOOTER = "Ctrl-C detaches, training goes on; dr-stop-training stops it."

STATE_STYLES = {
    "running": "green",
    "starting": "cyan",
    "finished": "bold green",
    "stopped": "yellow",
    "failed": "bold red",
    "lost": "bold red",
}


def live(report: "RunReport", now_s: float, *, verbose: bool = False) -> RenderableType:
    """The display that follows a training.

    Every line is cut at the edge of the terminal and every missing one is left empty, so that its
    height depends on nothing but the number of workers, and that only where `verbose` is chosen.

    Args:
        report: The run as it is.
        now_s: Unix seconds, for the clock.
        verbose: A line for each worker, and where the time of the newest iteration went.
    """
    ended = report.state not in ("starting", "running")
    parts: list[RenderableType] = [_head(report), Text(_pace(report, now_s))]
    if verbose:
        parts += [Text(f"{worker.name}: {worker.activity}") for worker in report.workers]
        parts.append(Text(_time_split(report)))
    else:
        activities = (f"{w.name} {w.activity}" for w in report.workers if w.activity)
        parts.append(Text("   ".join(activities), style="dim"))
    parts += [_iterations(report.history[-LIVE_ROWS:], LIVE_ROWS), *_curves(report.history)]
    # A warning names the best checkpoint too, so it takes the place of the line about them.
    parts.append(
        Text(f"Warning: {report.warning}", style="bold yellow")
        if report.warning
        else Text(_checkpoints(report))
    )
    parts.append(Text("" if ended else FOOTER, style="dim"))
    for part in parts:
        if isinstance(part, Text):
            part.no_wrap, part.overflow = True, "ellipsis"
    return Group(*parts)


def run(report: "RunReport") -> RenderableType:
    """Everything `dr status` has to say."""
    if report.state == "none":
        return Text("Nothing was started here yet. Start with `dr-start-training`.")
    head = _head(report)
    parts: list[RenderableType] = [Text.assemble(f"Run {report.run_id}: ", head)]
    if report.message:
        parts.append(Text(report.message))
    if report.state in ("starting", "running"):
        for worker in report.workers:
            alive = "alive" if worker.alive else "DEAD"
            again = f", restarted {worker.restarts} x" if worker.restarts else ""
            parts.append(
                Text(f"  {worker.name} ({alive}, process {worker.pid}{again}): {worker.activity}")
            )
    if report.history:
        last = report.history[-1]
        laps = sum(record.full_laps for record in report.history)
        parts += [
            _iterations(report.history[-STATUS_ROWS:], 0),
            *_curves(report.history),
            Text(
                f"{last.total_steps:,} steps in {_clock(report.elapsed_s)}, "
                f"{last.steps_per_s:.0f} steps/s, {last.real_time_factor:.0f} x real time, "
                f"{laps} full training laps."
            ),
            Text(_checkpoints(report)),
        ]
        if report.warning:
            parts.append(Text(f"Warning: {report.warning}", style="bold yellow"))
    return Group(*parts)


def evaluation(report: "EvaluationReport") -> RenderableType:
    """The trials of an evaluation, and the sentence that sums them up."""
    if report.opponent is None:
        return Group(_trials(report), Text(_laps(report), style="bold"))
    return Group(
        Text(report.prefix, style="bold"),
        _trials(report),
        Text(report.opponent.prefix, style="bold"),
        _trials(report.opponent),
        Text(_laps(report), style="bold"),
        Text(_laps(report.opponent), style="bold"),
        Text(_winner(report, report.opponent), style="bold"),
    )


def _trials(report: "EvaluationReport") -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("trial", "progress", "lap time", "status", "off track", "crashes", "resets"):
        table.add_column(name, justify="left" if name == "status" else "right")
    for trial in report.trials:
        table.add_row(
            str(trial.trial),
            f"{trial.progress:.0f} %",
            f"{trial.lap_s:.2f} s",
            trial.status,
            str(trial.off_track),
            str(trial.crashes),
            str(trial.resets),
        )
    return table


def _laps(report: "EvaluationReport") -> str:
    best = f", best {report.best_lap_s:.2f} s" if report.best_lap_s is not None else ""
    return (
        f"{report.completed} of {len(report.trials)} laps{best}, "
        f"checkpoint {report.checkpoint} of {report.prefix} on {report.world}."
    )


def _winner(own: "EvaluationReport", other: "EvaluationReport") -> str:
    """Who won a race: who finished more laps, then who took less time for all of them."""
    if own.completed != other.completed:
        first = own if own.completed > other.completed else other
        return f"{first.prefix} wins with more laps."
    if own.total_s is None or other.total_s is None or own.total_s == other.total_s:
        return "Nobody wins."
    first, second = (own, other) if own.total_s < other.total_s else (other, own)
    ahead_s = abs(own.total_s - other.total_s)
    return f"{first.prefix} wins, {ahead_s:.2f} s ahead of {second.prefix}."


def track_list(found: "TrackList") -> RenderableType:
    """All tracks, a line each, and where the racer's own lie."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("track", "length", "width", "direction", "from"):
        table.add_column(name, justify="right" if name in ("length", "width") else "left")
    for track in found.tracks:
        table.add_row(
            track.name,
            f"{track.length_m:.1f} m",
            f"{track.width_m:.2f} m",
            track.direction,
            f"{Path(track.source).suffix} file" if track.source != "own" else _origin(track),
        )
    return Group(table, Text(f"{len(found.tracks)} tracks; your own lie in {found.folder}."))


def track(view: "TrackView") -> RenderableType:
    """A track's map and facts."""
    parts: list[RenderableType] = [Text(line) for line in view.map_lines]
    parts.append(track_facts(view.facts))
    if view.picture:
        parts.append(Text(f"Picture: {view.picture}"))
    return Group(*parts)


def track_facts(facts: "TrackFacts") -> RenderableType:
    """What there is to know about a track, in three lines."""
    line = "is part of the road" if facts.line_family == "in" else "lies beside the road"
    width = (
        f"{facts.width_m:.2f} m"
        if facts.greatest_width_m - facts.least_width_m < 0.02
        else f"{facts.least_width_m:.2f} to {facts.greatest_width_m:.2f} m"
    )
    return Group(
        Text(f"{facts.name}: {facts.about}" if facts.about else facts.name, style="bold"),
        Text(
            f"{facts.length_m:.2f} m long, {width} wide, {facts.direction}; "
            f"{facts.waypoints} waypoints, {facts.spacing_m:.2f} m apart"
        ),
        Text(f"the white line {line}; {_origin(facts)}"),
    )


def _origin(facts: "TrackFacts") -> str:
    if facts.source != "own":
        return facts.source
    return f"built in, {facts.difficulty}" if facts.difficulty else "built in"


def iteration_line(record: "IterationRecord", *, verbose: bool = False) -> str:
    """One iteration in one line, for logs and pipes; a long one where `verbose` is chosen."""
    line = (
        f"{_clock(record.elapsed_s):>7} iter {record.iteration:3d} {record.total_steps:7d} steps  "
        f"reward {record.mean_reward:6.1f}  progress {record.mean_progress:5.1f} %  "
        f"eval {_evaluated(record)}"
    )
    if not verbose:
        return line
    return (
        f"{line}  laps {record.full_laps}/{record.episodes}  entropy {record.entropy:.3f}  "
        f"policy loss {record.surrogate_loss:.4f}  value loss {record.value_loss:.4f}  "
        f"KL {record.kl:.4f}  {record.steps_per_s:.0f} steps/s  "
        f"{record.real_time_factor:.0f} x real time  {_seconds(record)}"
    )


def start_text(plan: "RunPlan") -> str:
    """What is going to be trained, from what."""
    settings, inputs = plan.job.settings, plan.inputs
    workers = "1 worker" if settings.workers == 1 else f"{settings.workers} workers"
    begin = f", resuming from {plan.resumes}" if plan.resumes else ""
    if plan.pretrained is not None:
        begin = f", with the weights of {_source(plan.pretrained)}"
    files = (inputs.reward, inputs.hyperparameters, inputs.metadata)
    model = f"s3://{settings.bucket}/{settings.model_prefix}"
    return "\n".join(
        [
            *([f"Wiping path {model}"] if plan.wiped else []),
            f"Training of model {model} starting{begin}.",
            f"World {settings.world_name}, {workers}, seed {plan.job.seed}.",
            "Using configuration files:",
            *(f"   {file.origin}" for file in files),
        ]
    )


def increment(step: "Increment") -> RenderableType:
    """From which weights the new model will start."""
    return Text(f"{step.after} starts with the weights of {_source(step.pretrained)}.")


def _source(pretrained: "Pretrained") -> str:
    return f"{pretrained.prefix} ({pretrained.checkpoint} checkpoint {pretrained.name})"


def end_text(report: "RunReport") -> str:
    """How a training ended."""
    best = f" Best checkpoint: {report.best.name}." if report.best else ""
    return f"{report.message}{best} {report.remedy}".strip()


def _head(report: "RunReport") -> Text:
    """Which run, and in what state."""
    return Text.assemble(
        (report.state, STATE_STYLES.get(report.state, "")),
        f"  s3://{report.bucket}/{report.prefix}  on {report.world}",
    )


def _pace(report: "RunReport", now_s: float) -> str:
    """How long it has trained and how fast it is."""
    clock = _clock(now_s - report.started_at) if report.started_at else "0:00"
    if not report.history:
        return f"{clock}   the first iteration is being driven"
    last = report.history[-1]
    return (
        f"{clock}   iteration {last.iteration + 1}   {last.total_steps:,} steps   "
        f"{last.steps_per_s:.0f} steps/s   {last.real_time_factor:.0f} x real time"
    )


def _time_split(report: "RunReport") -> str:
    if not report.history:
        return ""
    last = report.history[-1]
    return f"iteration {last.iteration} took: {_seconds(last)}   KL {last.kl:.4f}"


def _seconds(record: "IterationRecord") -> str:
    return (
        f"drive {record.drive_s:.1f} s  learn {record.learn_s:.1f} s  "
        f"exchange {record.exchange_s:.1f} s"
    )


def _iterations(records: "list[IterationRecord]", rows: int) -> Table:
    """The given iterations, filled up to a fixed number of rows."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name, width in ITERATION_COLUMNS.items():
        table.add_column(name, min_width=width, justify="right", no_wrap=True)
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


def _curves(records: "list[IterationRecord]") -> list[Text]:
    """Mean progress, the evaluations below it, and mean reward."""
    progress = [record.mean_progress for record in records]
    reward = [record.mean_reward for record in records]
    completed = [_completed(record) for record in records]
    return [
        _curve("progress", sparkline.curve(progress, CURVE_WIDTH, top=100.0), "green")
        + (f"  {progress[-1]:.1f} %" if progress else ""),
        _curve("eval", sparkline.marks(completed, CURVE_WIDTH), "bold")
        + (f"  {sparkline.ALL} all laps" if any(completed) else ""),
        _curve("reward", sparkline.curve(reward, CURVE_WIDTH), "cyan")
        + (f"  {reward[-1]:.1f}" if reward else ""),
    ]


def _curve(name: str, drawn: str, style: str) -> Text:
    return Text.assemble((f"{name:9}", "dim"), (f"{drawn:{CURVE_WIDTH}}", style))


def _completed(record: "IterationRecord") -> float | None:
    """Share of the evaluation's laps that were completed, None before it."""
    if not record.evaluation_progress:
        return None
    return len(record.evaluation_lap_s) / len(record.evaluation_progress)


def _evaluated(record: "IterationRecord") -> str:
    progress = record.evaluation_progress
    if not progress:
        return "..."
    return f"{sum(progress) / len(progress):.0f} % {len(record.evaluation_lap_s)}/{len(progress)}"


def _checkpoints(report: "RunReport") -> str:
    best, last = report.best, report.last
    if best is None or last is None:
        return "No checkpoint yet."
    metric = f" ({best.metric:.1f})" if best.metric is not None else ""
    return f"best {best.name}{metric}   last {last.name}"


def _clock(seconds: float) -> str:
    whole = max(0, int(seconds))
    hours, rest = divmod(whole, 3600)
    minutes, left = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{left:02d}" if hours else f"{minutes}:{left:02d}"
