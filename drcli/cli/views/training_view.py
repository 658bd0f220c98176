"""Shows a training live, its state, start and end."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.base.report import clock, counted
from drcli.cli.show import fitted, group
from drcli.cli.views import iterations

if TYPE_CHECKING:
    from drcli.run.plan import EndWorkPlan, RunPlan
    from drcli.run.status import RunReport

LIVE_ROWS = 6
STATUS_ROWS = 10
_FIRST, _SILENT = "driving the first iteration", "the bucket does not answer"
FOOTER = "Ctrl-C leaves this display; dr-stop-training stops the training."


@fitted
def live(
    columns: int, report: "RunReport", now_s: float, *, verbose: bool = False
) -> RenderableType:
    """The display that follows a training; `now_s` is in Unix seconds.

    Long lines are cut, and missing ones left empty, so that the height stays the same, but for a
    teacher's line from its first checkpoint on.
    """
    parts: list[RenderableType] = [Text.assemble(*report.state_text()), Text(_pace(report, now_s))]
    if report.phase is not None:
        parts.append(Text(_phase(report), style="cyan"))
    if verbose:
        parts += [Text(f"{worker.name}: {worker.activity}") for worker in report.workers]
        parts += [Text(str(worker)) for worker in report.joined]
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
    warning = Text(f"Warning: {report.warning}", style="bold yellow")
    parts.append(warning if report.warning else Text(report.checkpoints_text()))
    if report.limit:
        parts.append(Text(f"best lap {report.limit}"))
    parts.append(Text(FOOTER if report.state in ("starting", "running") else "", style="dim"))
    for part in parts:
        if isinstance(part, Text):
            part.no_wrap, part.overflow = True, "ellipsis"
    return Group(*parts)


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


@fitted
def run(columns: int, report: "RunReport") -> RenderableType:
    if report.state == "none":
        return report.nothing_here()
    parts = [group(report.before_history()), Text(_second(report))]
    if report.history:
        parts += [
            iterations.table(report.history[-STATUS_ROWS:], 0, columns),
            *iterations.curves(report.history, columns),
        ]
    return Group(*(each for each in [*parts, group(report.after_history())] if each))


def start_text(plan: "RunPlan") -> str:
    config, inputs = plan.job.config, plan.inputs
    workers = counted(config.train.workers or plan.job.ray_workers, "worker")
    begin = f", resuming from {plan.resumes}" if plan.resumes else ""
    if plan.pretrained is not None:
        begin = f", with the weights of {plan.pretrained.source()}"
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


def _pace(report: "RunReport", now_s: float) -> str:
    since = clock(now_s - report.started_at) if report.started_at else "0:00"
    if not report.history:
        return f"{since}   {_SILENT if report.unreachable else _FIRST}"
    last = report.history[-1]
    return (
        f"{since}   iteration {last.iteration + 1}   {last.total_steps:,} steps   "
        f"{last.steps_per_s:.0f} steps/s   {last.real_time_factor:.0f} x real time"
    )


def _time_split(report: "RunReport") -> str:
    if not report.history:
        return ""
    last = report.history[-1]
    times = iterations.time_split(last)
    return f"iteration {last.iteration} took: {times}   {iterations.last_step(last)}"
