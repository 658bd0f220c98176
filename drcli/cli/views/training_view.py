"""Shows a training live, its state, start and end."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.base.report import abridged, counted
from drcli.cli.show import fitted, indented
from drcli.cli.views import iterations

if TYPE_CHECKING:
    from drcli.records.reward import RewardErrorEntry
    from drcli.records.training_record import Pretrained
    from drcli.run.increment import Increment
    from drcli.run.plan import EndWorkPlan, RunPlan
    from drcli.run.status import JoinedReport, RunReport, WorkerReport

LIVE_ROWS = 6
STATUS_ROWS = 10
_FIRST, _SILENT = "driving the first iteration", "the bucket does not answer"
FOOTER = "Ctrl-C leaves this display; dr-stop-training stops the training."

NOTES = 3
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
    """The display that follows a training; `now_s` is in Unix seconds.

    Long lines are cut, and missing ones left empty, so that the height stays the same, but for a
    teacher's line from its first checkpoint on.
    """
    parts: list[RenderableType] = [_head(report), Text(_pace(report, now_s))]
    if report.phase is not None:
        parts.append(Text(_phase(report), style="cyan"))
    if verbose:
        parts += [Text(f"{worker.name}: {worker.activity}") for worker in report.workers]
        parts += [Text(_joined(worker)) for worker in report.joined]
        parts.append(Text(_time_split(report)))
    else:
        activities = [f"{w.name} {w.activity}" for w in report.workers if w.activity]
        if report.joined:  # first, because the end of the line may be cut
            activities.insert(0, f"{len(report.joined)} joined")
        parts.append(Text("   ".join(activities), style="dim"))
    parts += [
        iterations.table(report.history[-LIVE_ROWS:], LIVE_ROWS, columns),
        *iterations.curves(report.history, columns),
    ]
    # A warning names the best checkpoint too, so it replaces the line about checkpoints.
    parts.append(_warning(report) if report.warning else Text(_checkpoints(report)))
    if report.limit:
        parts.append(Text(f"best lap {report.limit}"))
    parts.append(Text(FOOTER if report.state in ("starting", "running") else "", style="dim"))
    for part in parts:
        if isinstance(part, Text):
            part.no_wrap, part.overflow = True, "ellipsis"
    return Group(*parts)


@fitted
def run(columns: int, report: "RunReport") -> RenderableType:
    if report.state == "none":
        return Text(_nothing_here(report))
    parts: list[RenderableType] = [Text.assemble(f"Run {report.run_id}: ", _head(report))]
    if report.message:
        parts.append(Text(report.message))
    if report.state in ("failed", "interrupted", "finished") and report.remedy:
        parts.append(indented(f"Try: {report.remedy}"))
    if report.state in ("starting", "running"):
        parts += [indented(_worker(worker, ending=report.ending)) for worker in report.workers]
        parts += [indented(_joined(worker)) for worker in report.joined]
        if limits := _limits(report):
            parts.append(indented(limits))
    parts += [Text(f"Warning: {text}", style="bold yellow") for text in report.watches]
    if report.unreachable:
        unknown = f"Iterations and checkpoints are unknown: {report.unreachable}"
        parts.append(Text(unknown, style="bold yellow"))
    parts += [Text(line) for line in (_stage(report), _phase(report), _second(report)) if line]
    if report.history:
        last = report.history[-1]
        laps = sum(record.full_laps for record in report.history)
        episodes = sum(record.episodes for record in report.history)
        parts += [
            iterations.table(report.history[-STATUS_ROWS:], 0, columns),
            *iterations.curves(report.history, columns),
            Text(
                f"{last.total_steps:,} steps in {iterations.clock(report.elapsed_s)}, "
                f"{last.steps_per_s:.0f} steps/s, {last.real_time_factor:.0f} x real time."
            ),
            Text(f"{laps:,} of {counted(episodes, 'training episode')} completed a lap."),
            *(Text(line) for line in [_newest(report)] if line),
            Text(_checkpoints(report)),
            *(Text(f"best lap {line}") for line in [report.limit] if line),
            *(Text(line) for line in [_convergence(report)] if line),
            *(Text(line) for line in _milestones(report)),
        ]
        if report.warning:
            parts += [_warning(report), *(indented(f"Try: {each}") for each in report.advice)]
    parts += [Text(line) for line in _failures(report)]
    lines = (_spent(report), _left(report), str(report.requests or ""), _budget(report))
    parts += [Text(line) for line in lines if line]
    parts += [Text(f"Note: {abridged(text)}") for text in report.notes[-NOTES:]]
    return Group(*parts)


def _nothing_here(report: "RunReport") -> str:
    model = f"s3://{report.bucket}/{report.prefix}"
    if report.unreachable:
        return (
            f"Nothing runs here. Whether {model} was trained, or another machine trains it, is "
            f"unknown: {report.unreachable}"
        )
    if report.elsewhere:
        return f"Nothing was started here. {report.elsewhere}"
    return (
        "Nothing was started here yet. Start with `dr-start-training`, or continue a model that "
        "exists with `dr-start-training --resume`."
    )


def _joined(worker: "JoinedReport") -> str:
    part = counted(worker.episodes, "episode") if worker.episodes else "no episodes now"
    silent = "" if worker.alive else ", silent"
    return f"{worker.name} on {worker.host}: {worker.activity or 'starting'} ({part}{silent})"


def _milestones(report: "RunReport") -> list[str]:
    words: dict[str, list[str]] = {}
    for each in report.milestones:
        words.setdefault(each.checkpoint, []).append(each.word)
    numbers = {each.checkpoint: each for each in report.milestones}
    return [
        f"{', '.join(words[name])}: {name.partition('_')[0]} ({found.laps} of "
        f"{found.episodes} laps clean, best {found.best_lap_s:.2f} s)"
        for name, found in numbers.items()
    ]


def _stage(report: "RunReport") -> str:
    stage = report.stage
    if stage is None:
        return ""
    number = 0
    if report.history:
        number = max(0, report.history[-1].iteration + 1 - stage.iteration)
    text = f"Stage {stage.number} of {stage.count}: {stage.name}, on {stage.world}, "
    return f"{text}{counted(number, 'iteration')} so far; it ends {stage.goal}."


def _phase(report: "RunReport") -> str:
    text = "" if report.phase is None else report.phase.text
    return f"{text[:1].upper()}{text[1:]}"


def _second(report: "RunReport") -> str:
    evaluated = [record for record in report.history if record.second_progress]
    if not evaluated:
        return ""
    last = evaluated[-1]
    return (
        f"On {last.second_world}, checkpoint {last.iteration} drove "
        f"{iterations.second_evaluation(last)}."
    )


def _budget(report: "RunReport") -> str:
    text = "" if report.budget is None else str(report.budget)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _limits(report: "RunReport") -> str:
    parts = ["low priority (DR_PRIORITY)"] if report.priority == "low" else []
    if report.threads:
        parts.append(f"at most {counted(report.threads, 'core')} (DR_THREADS)")
    return f"processor: {', '.join(parts)}" if parts else ""


def _spent(report: "RunReport") -> str:
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


def start_text(plan: "RunPlan") -> str:
    config, inputs = plan.job.config, plan.inputs
    workers = counted(config.train.workers or plan.job.ray_workers, "worker")
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
        *(["Stages:"] if plan.job.stages else []),
        *(
            f"   {number}. {stage.name}, on {stage.race().world_name}: ends {stage.goal}"
            for number, stage in enumerate(plan.job.stages, start=1)
        ),
        plan.ends,
    ]
    return "\n".join(lines)


def end_work_text(plan: "EndWorkPlan") -> str:
    config = plan.job.config
    model = f"s3://{config.storage.bucket}/{config.model.prefix}"
    return (
        f"{model}: {plan.outcome.message} Still to do at its end: {', '.join(plan.outcome.left)}."
    )


def increment(step: "Increment") -> RenderableType:
    return Text(f"{step.after} starts with the weights of {_source(step.pretrained)}.")


def end_text(report: "RunReport") -> str:
    best = report.best
    told = f" Best checkpoint {best.text}." if best is not None and best.metric is not None else ""
    counts = report.reward_errors
    failed = f" {counts.failures()}." if counts is not None and counts.failed else ""
    untaught = ""
    if report.phase is not None and report.phase.name == "teacher":
        untaught = (
            " It ended in the phase teacher: the camera policy learns from the next phase on "
            "(`dr-start-training --resume`)."
        )
    return f"{report.message}{told}{untaught}{failed} {report.remedy}".strip()


def next_commands(report: "RunReport", prefix: str) -> list[tuple[str, str]]:
    """Commands after a training, with purposes; none if the settings name another model."""
    ended = report.state in ("finished", "stopped")
    if report.best is None or not ended or report.prefix != prefix:
        return []
    if report.best_laps is not None and report.best_laps.clean:
        return [
            (
                "dr-evaluate --checkpoint best --laps 40",
                "see how many laps the best checkpoint drives clean",
            ),
            ("dr-video --checkpoint best", "watch a lap of it"),
            ("dr-export car --best", "write the archive for the car"),
        ]
    if report.best_laps is None and report.phase is not None and report.phase.name == "teacher":
        return [("dr-start-training --resume", "go on until the camera policy has learned")]
    return [
        ("dr-analyze", "see what keeps it from completing a lap"),
        ("dr-video --checkpoint best", "watch how far its best checkpoint comes"),
        ("dr-start-training --resume", "train on"),
    ]


def _worker(worker: "WorkerReport", *, ending: bool) -> str:
    if worker.pid is None:
        return f"{worker.name}: not started, or left out"
    gone = "ended" if ending else "DEAD"
    state = f"{'alive' if worker.alive else gone}, process {worker.pid}"
    state += f", restarted {worker.restarts} x" if worker.restarts else ""
    health = f" ({worker.health.words(worker.name)})" if worker.health and worker.alive else ""
    host = f" on {worker.host}" if worker.host else ""
    activity = "" if ending and not worker.alive else f": {worker.activity}{health}"
    return f"{worker.name} ({state}){host}{activity}"


def _source(pretrained: "Pretrained") -> str:
    return f"{pretrained.prefix} ({pretrained.checkpoint} checkpoint {pretrained.name})"


def _warning(report: "RunReport") -> Text:
    return Text(f"Warning: {report.warning}", style="bold yellow")


def _convergence(report: "RunReport") -> str:
    found = report.convergence
    if found is None:
        return ""
    state = "converged" if found.reached else f"a gap of {abs(found.gap):.0f} points"
    return (
        f"Completion: training {found.training:.0f} %, evaluations {found.evaluation:.0f} %: "
        f"{state}."
    )


def _failures(report: "RunReport") -> list[str]:
    lines = [f"Rollback: {rollback.sentence}" for rollback in report.rollbacks]
    counts = report.reward_errors
    if counts is None or not (counts.failed or counts.discarded):
        return lines
    parts = []
    if counts.failed:
        parts.append(
            f"{counts.failed:,} of {counts.calls:,} calls failed ({100.0 * counts.share:.2g} %)"
        )
    if counts.discarded:
        parts.append(f"{counted(counts.discarded, 'episode')} declared broken")
    lines.append(f"Reward function: {', '.join(parts)}.")
    for entry in counts.errors:
        lines.append(f"  {entry.text} ({counted(entry.count, 'time')})")
        lines += [f"    {text}" for text in (entry.source, _params(entry)) if text]
    return lines


def _params(entry: "RewardErrorEntry") -> str:
    return f"params = {entry.params}" if entry.params else ""


def _head(report: "RunReport") -> Text:
    return Text.assemble(
        (report.state, STATE_STYLES.get(report.state, "")),
        f"  s3://{report.bucket}/{report.prefix}  on {report.world}",
        f"  {report.stage}" if report.stage is not None else "",
    )


def _pace(report: "RunReport", now_s: float) -> str:
    clock = iterations.clock(now_s - report.started_at) if report.started_at else "0:00"
    if not report.history:
        return f"{clock}   {_SILENT if report.unreachable else _FIRST}"
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
    number = last.name.partition("_")[0]
    if best.metric is None and report.phase is not None and report.phase.name == "teacher":
        return f"last {number}; checkpoints are evaluated from the next phase on"
    if best.metric is None:
        return f"last {number}, none was evaluated yet"
    return f"best {best.text}   last {number}"


def _newest(report: "RunReport") -> str:
    newest = report.newest_laps
    if newest is None:
        return ""
    return f"newest evaluation {newest.checkpoint}: {newest.text}"
