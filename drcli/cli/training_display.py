"""Shows a training live, its state, start and end."""

import math
from collections.abc import Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drcli.base.report import clock, counted
from drcli.cli.show import CURVE_COLUMNS, LEAST_CURVE_COLUMNS, curve, fitted, group, marks
from drcli.config.track_names import training_races
from drcli.records.iteration import Laps

if TYPE_CHECKING:
    from drcli.config.run_config import DriveConfig
    from drcli.records.iteration import IterationRecord
    from drcli.run.plan import EndWorkPlan, RunPlan
    from drcli.run.status import RunReport

LEAST_LIVE_ROWS = 2
ROWS_FOR_A_CURVE_ROW = 6
"""Three curves get half of the height, the iterations the rest."""
STATUS_ROWS = 10
_FIRST, _SILENT = "driving the first iteration", "the bucket does not answer"
FOOTER = "Ctrl-C leaves this display; dr-stop-training stops the training."


@fitted
def live(
    columns: int, report: "RunReport", now_s: float, height: int, *, verbose: bool = False
) -> RenderableType:
    """The display that follows a training; `now_s` is in Unix seconds.

    Fills a terminal of this `height` except its last line, with as many iterations as fit. Long
    lines are cut, and missing ones left empty, so that the height stays the same.
    """
    parts: list[RenderableType] = [Text.assemble(*report.state_text()), Text(_pace(report, now_s))]
    if text := report.phase_text():
        parts.append(Text(text, style="cyan"))
    if verbose:
        parts += [Text(f"{worker.name}: {worker.activity}") for worker in report.workers]
        parts += [Text(str(worker)) for worker in report.joined]
        parts.append(Text(_time_split(report)))
    else:
        activities = [f"{w.name} {w.activity}" for w in report.workers if w.activity]
        if report.joined:  # first, because the end of the line may be cut
            activities.insert(0, f"{len(report.joined)} joined")
        parts.append(Text("   ".join(activities), style="dim"))
    below: list[Text] = []
    # A warning names the best checkpoint too, so it replaces the line about checkpoints.
    warning = Text(f"Warning: {report.warning}", style="bold yellow")
    below.append(warning if report.warning else Text(report.checkpoints_text()))
    if report.limit:
        below.append(Text(f"best lap {report.limit}"))
    below.append(Text(_footer(report), style="dim"))
    free = height - len(parts) - len(below) - 2
    tall = max(1, free // ROWS_FOR_A_CURVE_ROW)
    drawn = curves(report.history, columns, columns, tall)
    rows = max(LEAST_LIVE_ROWS, free - len(drawn))
    parts += [table(report.history[-rows:], rows, columns), *drawn, *below]
    for part in parts:
        if isinstance(part, Text):
            part.no_wrap, part.overflow = True, "ellipsis"
    return Group(*parts)


def _footer(report: "RunReport") -> str:
    if report.state not in ("starting", "running"):
        return ""
    if report.pid is None:
        host = next((worker.host for worker in report.workers if worker.host), "another machine")
        return f"Ctrl-C leaves this display; the training runs on {host}."
    return FOOTER


def _second_world(report: "RunReport") -> str:
    evaluated = [record for record in report.history if record.second_progress]
    if not evaluated:
        return ""
    last = evaluated[-1]
    return f"On {last.second_world}, checkpoint {last.iteration} drove {second_evaluation(last)}."


@fitted
def run(columns: int, report: "RunReport") -> RenderableType:
    if report.state == "none":
        return report.nothing_here()
    parts = [group(report.before_history()), Text(_second_world(report))]
    if report.history:
        parts += [
            table(report.history[-STATUS_ROWS:], 0, columns),
            *curves(report.history, columns, CURVE_COLUMNS),
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
        f"World {config.race().world_name}{_further(config.race())}, {workers}, seed "
        f"{plan.job.seed}.",
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


def _further(race: "DriveConfig") -> str:
    count = len(training_races(race)) - 1
    return f" and {counted(count, 'further track')}" if count else ""


def end_work_text(plan: "EndWorkPlan") -> str:
    config = plan.job.config
    model = f"s3://{config.storage.bucket}/{config.model.prefix}"
    return (
        f"{model}: {plan.outcome.message} Still to do at its end: {', '.join(plan.outcome.left)}."
    )


def next_commands(report: "RunReport") -> list[tuple[str, str]]:
    """Commands after a training, with purposes."""
    ended = report.state in ("finished", "stopped")
    if report.best is None or not ended:
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
    # Before the first evaluation the untrained checkpoint counts as the best one.
    word, which = ("best", "best") if report.best_laps is not None else ("last", "newest")
    return [
        ("dr-analyze", "see what keeps it from completing a lap"),
        (f"dr-video --checkpoint {word}", f"watch how far its {which} checkpoint comes"),
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
    times = time_split(last)
    return f"iteration {last.iteration} took: {times}   {last_step(last)}"


# Iterations in lines, tables and curves.


BESIDE_CURVE = 26
LEAST_COLUMNS = {
    "iter": 4,
    "steps": 9,
    "reward": 7,
    "progress": 8,
    "laps": 6,
    "lap": 7,
    "eval": 9,
    "median": 7,
    "eval 2": 9,
    "stage": 5,
    "phase": 5,
    "entropy": 7,
    "losses": 12,
}
LONGEST_STAGE = 12
GAP = 2
RARE = ("eval 2", "stage", "phase")
OPTIONAL = ("phase", "losses", "entropy", "steps", "laps", "reward", "lap")
"""Narrow terminals omit them in this order."""


def line(record: "IterationRecord", *, verbose: bool = False) -> str:
    short = (
        f"{clock(record.elapsed_s):>7} iter {record.iteration:3d}  reward {record.mean_reward:6.1f}"
        f"  progress {record.mean_progress:3.0f} %  eval {evaluation(record)}"
    )
    if record.second_progress:
        short += f"  on {record.second_world} {second_evaluation(record)}"
    if record.stage:
        short += f"  stage {record.stage}"
    if record.phase:
        short += f"  phase {record.phase}"
    if not verbose:
        return short
    return (
        f"{short}  {record.total_steps} steps  laps {record.full_laps}/{record.episodes}  "
        f"entropy {_known(record.entropy, 3)}  "
        f"{_named_losses(record)}  {record.steps_per_s:.0f} steps/s  "
        f"{record.real_time_factor:.0f} x real time  {time_split(record)}"
    )


def table(records: "list[IterationRecord]", rows: int, columns: int) -> Table:
    lines = [_cells(record) for record in records]
    widths = {
        name: max(least, *(len(cells[name]) for cells in lines), 0)
        for name, least in LEAST_COLUMNS.items()
        if name not in RARE or any(cells[name] for cells in lines)
    }
    for name in (name for name in OPTIONAL if name in widths):
        if sum(widths.values()) + GAP * (len(widths) - 1) > columns:
            del widths[name]
    shown = Table(box=None, pad_edge=False, header_style="dim")
    sac = any(record.actor_loss is not None for record in records)
    for name, width in widths.items():
        header = {"losses": "loss a/c" if sac else "loss p/v"}.get(name, name)
        shown.add_column(header, min_width=width, justify="right", no_wrap=True)
    for cells in lines:
        shown.add_row(*(cells[name] for name in widths))
    for _ in range(rows - len(records)):
        shown.add_row()
    return shown


def curves(
    records: "list[IterationRecord]", columns: int, widest: int, rows: int = 1
) -> list[Text]:
    """Lines; all curves but the one of the evaluations have so many `rows`."""
    width = max(LEAST_CURVE_COLUMNS, min(widest, columns - BESIDE_CURVE))
    progress = curve([record.mean_progress for record in records], width, top=100.0, rows=rows)
    reward = curve([record.mean_reward for record in records], width, rows=rows)
    sampled = [record.evaluation for record in records]
    shares = [None if laps is None else laps.clean / laps.driven for laps in sampled]
    newest = next((laps for laps in reversed(sampled) if laps is not None), None)
    last = records[-1] if records else None
    laps_s = [record.best_lap_s for record in records]
    fastest_s = min((each for each in laps_s if each is not None), default=None)
    best = "" if fastest_s is None else f"best {fastest_s:.2f} s"
    lines = (
        ("progress", progress, "green", f"{last.mean_progress:.1f} %" if last else ""),
        (
            "eval",
            marks(shares, width),
            "bold",
            f"{newest.clean} of {newest.driven} clean" if newest is not None else "",
        ),
        ("reward", reward, "cyan", f"{last.mean_reward:.1f}" if last else ""),
        ("lap", curve(laps_s, width, rows=rows), "yellow", best),
    )
    return [
        Text.assemble((f"{first:9}", "dim"), (f"{drawn:{width}}", style), "  ", told)
        for name, high, style, value in lines
        for first, drawn, told in zip_longest([name], high.split("\n"), [value], fillvalue="")
    ]


def time_split(record: "IterationRecord") -> str:
    return (
        f"drive {record.drive_s:.1f} s  learn {record.learn_s:.1f} s  "
        f"exchange {record.exchange_s:.1f} s"
    )


def last_step(record: "IterationRecord") -> str:
    """How far the policy moved, SAC's temperature, or the student's distance from its teacher."""
    if record.imitation_loss is not None:
        return f"imitation loss {record.imitation_loss:.4f}"
    if record.alpha is not None:
        return f"alpha {record.alpha:.4f}"
    return f"KL {_known(record.kl, 4)}"


def _cells(record: "IterationRecord") -> dict[str, str]:
    second = _second(record)
    return {
        "iter": str(record.iteration),
        "steps": f"{record.total_steps:,}",
        "reward": f"{record.mean_reward:.1f}",
        "progress": f"{record.mean_progress:.1f} %",
        "laps": f"{record.full_laps}/{record.episodes}",
        "lap": "" if record.best_lap_s is None else f"{record.best_lap_s:.2f} s",
        "eval": _first(record),
        "median": _median(record.evaluation),
        "eval 2": _evaluated(record.second_progress, second) if second is not None else "",
        "stage": record.stage[:LONGEST_STAGE],
        "phase": record.phase,
        "entropy": _known(record.entropy, 2),
        "losses": _losses(record),
    }


def _losses(record: "IterationRecord") -> str:
    """Of policy and value, actor and critic, or student."""
    if record.imitation_loss is not None:
        return f"imit {record.imitation_loss:.3f}"
    if record.actor_loss is not None and record.critic_loss is not None:
        return f"{record.actor_loss:.3f}/{record.critic_loss:.2f}"
    return f"{_known(record.surrogate_loss, 3)}/{_known(record.value_loss, 2)}"


def _named_losses(record: "IterationRecord") -> str:
    if record.imitation_loss is not None:
        return last_step(record)
    if record.actor_loss is not None and record.critic_loss is not None:
        losses = f"actor loss {record.actor_loss:.4f}  critic loss {record.critic_loss:.4f}"
    else:
        policy, value = _known(record.surrogate_loss, 4), _known(record.value_loss, 4)
        losses = f"policy loss {policy}  value loss {value}"
    return f"{losses}  {last_step(record)}"


def _known(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def evaluation(record: "IterationRecord") -> str:
    if record.phase == "teacher":
        return _first(record)
    return _with_median(record.evaluation_progress, record.evaluation)


def second_evaluation(record: "IterationRecord") -> str:
    return _with_median(record.second_progress, _second(record))


def _second(record: "IterationRecord") -> Laps | None:
    progress = record.second_progress
    return Laps(len(progress), record.second_lap_s) if progress else None


def _first(record: "IterationRecord") -> str:
    """A teacher has none: it sees no camera."""
    if record.phase == "teacher":
        return "-"
    return _evaluated(record.evaluation_progress, record.evaluation)


def _with_median(progress: Sequence[float], laps: Laps | None) -> str:
    clean = "" if laps is None else " clean"
    return f"{_evaluated(progress, laps)}{clean} {_median(laps)}".rstrip()


def _evaluated(progress: Sequence[float], laps: Laps | None) -> str:
    if laps is None:
        return "..."
    return f"{sum(progress) / len(progress):.0f} % {laps.clean}/{laps.driven}"


def _median(laps: Laps | None) -> str:
    return f"{laps.median_s:.2f} s" if laps is not None and laps.median_s is not None else ""
