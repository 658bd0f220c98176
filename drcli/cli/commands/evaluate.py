"""`dr evaluate`, also `dr-start-evaluation`."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer
from rich.console import Group, RenderableType
from rich.text import Text

from drcli.base.errors import BadValue, WorkerDied, shown
from drcli.base.installation import lazy_imports
from drcli.cli import console
from drcli.cli import evaluation_options as options
from drcli.cli.fetch_tracks import bring_tracks
from drcli.cli.options import checkpoint_option, parsed_checkpoint
from drcli.cli.views.layout import Rows, fitted
from drcli.cli.working_folder import settings
from drcli.records.evaluation_task import PolicySource, RobustCell, RobustResult, Runtime
from drcli.records.iteration import counted_resets, lap_time

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.run.evaluation_loop import LoopReport
    from drcli.run.evaluation_report import EndPlace, EvaluationReport, LapsReport, TrialReport
    from drcli.run.many_evaluations import TableReport

with lazy_imports():
    from drcli.run import (
        evaluation,
        evaluation_loop,
        evaluation_plan,
        evaluation_report,
        many_evaluations,
        stopping,
    )


# Shows the trials of an evaluation.


def show_evaluation(report: "EvaluationReport") -> RenderableType:
    other = report.opponent
    if other is None:
        return Group(_trials(report), _bold(_laps(report)), *_limit(report), *_videos(report))
    cars = (_bold(_name(report)), _trials(report), _bold(_name(other)), _trials(other))
    result = (_laps(report), _laps(other), _winner(report, other))
    return Group(*cars, *map(_bold, result), *_videos(report), *_videos(other))


def _limit(report: "EvaluationReport") -> list[Text]:
    lost = f"Most time is lost at {'; '.join(report.lost)}." if report.lost else ""
    return [Text(line) for line in (report.limit and f"{report.limit}.", lost) if line]


def _videos(report: "EvaluationReport") -> list[Text]:
    return [Text(f"Video: {key}") for key in report.videos[-1:]]


def _name(report: "EvaluationReport") -> str:
    return report.prefix if report.file is None else report.checkpoint


def _bold(text: str) -> Text:
    return Text(text, style="bold")


def _trials(report: "EvaluationReport") -> Rows:
    penalties = any(trial.penalty_s for trial in report.trials)
    crashes = any(trial.crashes for trial in report.trials)
    return Rows(
        (
            *("trial", "progress", "lap time"),
            *(("driven", "penalty") if penalties else ()),
            *("ended", "off track"),
            *(("crashes",) if crashes else ()),
            "resets",
        ),
        [
            (
                str(trial.trial),
                f"{trial.progress:.0f} %",
                f"{trial.lap_s:.2f} s",
                *(_parts(trial) if penalties else ()),
                _ended(trial),
                str(trial.off_track),
                *((str(trial.crashes),) if crashes else ()),
                str(trial.resets),
            )
            for trial in report.trials
        ],
        left=("ended",),
    )


def _parts(trial: "TrialReport") -> tuple[str, str]:
    if trial.penalty_s is None:
        return "", ""
    return f"{trial.lap_s - trial.penalty_s:.2f} s", f"{trial.penalty_s:.2f} s"


def _ended(trial: "TrialReport") -> str:
    if not trial.finished:
        return trial.status
    return "clean lap" if trial.clean else "finished"


def _laps(report: "EvaluationReport") -> str:
    words = evaluation_report.summary(report.trials)
    run = evaluation_report.best_average(report.trials, report.average_laps)
    if run and report.average_laps > 1:
        words += f", best average of {report.average_laps} laps {report.best_average_s:.2f} s"
        resets = sum(trial.resets for trial in run)
        words += f" with {counted_resets(resets)}" if resets else ""
    driver = report.checkpoint
    if report.file is None:
        driver = f"checkpoint {driver} of {report.prefix}"
    engine = "" if report.runtime == "torch" else f" with --runtime {report.runtime}"
    return f"{words}; {driver}{engine} on {report.world}."


def _winner(own: "EvaluationReport", other: "EvaluationReport") -> str:
    """More finished laps win, then less time."""
    if own.completed != other.completed:
        first = own if own.completed > other.completed else other
        return f"{_name(first)} wins with more finished laps."
    if own.total_s is None or other.total_s is None or own.total_s == other.total_s:
        return "Nobody wins."
    first, second = (own, other) if own.total_s < other.total_s else (other, own)
    ahead_s = abs(own.total_s - other.total_s)
    return f"{_name(first)} wins, {ahead_s:.2f} s ahead of {_name(second)}."


# Tables of many evaluations.


def models_table(report: "TableReport") -> RenderableType:
    driven = [row for row in report.rows if not row.reason]
    columns = {
        "track": [row.world for row in driven],
        "model": [row.prefix for row in driven],
        "checkpoint": [row.checkpoint for row in driven],
        "clean laps": [f"{row.clean}/{row.trials}" for row in driven],
        "resets": [str(row.resets) for row in driven],
        "progress": [f"{row.progress:.0f} %" for row in driven],
        "median": [_seconds(row.median_s) for row in driven],
        "best lap": [_seconds(row.best_lap_s) for row in driven],
        "best average": [_seconds(row.best_average_s) for row in driven],
        "robust score": [_score(row.robust_score) for row in driven],
    }
    # Which of the last ones there are depends on what was driven.
    columns = {name: cells for name, cells in columns.items() if any(cells) or not driven}
    parts: list[RenderableType] = [
        Rows(
            list(columns),
            list(zip(*columns.values(), strict=True)),
            left=("track", "model", "checkpoint"),
        )
    ]
    failed = [row for row in report.rows if row.reason]
    if failed:
        parts.append(
            Rows(
                ("track", "model", "not evaluated"),
                [(row.world, row.prefix, row.reason) for row in failed],
                left=("track", "model", "not evaluated"),
            )
        )
    for best in report.best:
        parts.append(Text(f"Best on {best.world}: {best.prefix}. Train on from it there with:"))
        parts.append(Text(f"  {best.command}", style="bold"))
    return Group(*parts)


def robust_grid(result: "RobustResult") -> RenderableType:
    rows = Rows(
        ("disturbed", "level", "clean laps", "progress", "lap time", "ended by", "score of axis"),
        [
            (
                cell.axis,
                cell.level,
                f"{cell.completed}/{cell.trials}",
                f"{cell.progress:.0f} %",
                _seconds(cell.lap_s),
                cell.ended_by,
                f"{result.axis_scores[cell.axis]:.1f}" if first else "",
            )
            for cell, first in _with_first(result)
        ],
        left=("disturbed", "level", "ended by"),
    )
    broken = ", ".join(result.broken_by)
    said = f"Broken by: {broken}." if broken else "No level of the grid broke it."
    if result.cells[0].completed == 0:
        said = "It completes no clean lap even without disturbance."
    score = (
        f"Robust score {result.robust_score:.1f} of 100: checkpoint {result.checkpoint} of "
        f"{result.prefix} on {result.world}, seed {result.seed}."
    )
    return Group(rows, Text(said), Text(score, style="bold"))


def _with_first(result: "RobustResult") -> list[tuple["RobustCell", bool]]:
    axes = [cell.axis for cell in result.cells]
    return [(cell, axes.index(cell.axis) == place) for place, cell in enumerate(result.cells)]


def best_laps(report: "LoopReport") -> RenderableType:
    rounds = f"{report.rounds} round{'s' * (report.rounds != 1)}"
    failed = f", {report.failures} failed" if report.failures else ""
    said = Text(f"{rounds}{failed} of {report.prefix} on {report.world}.", style="bold")
    if not report.best:
        return Group(Text("No lap was completed."), said)
    rows = Rows(
        ("track", "best lap", "resets", "best average", "clean laps", "checkpoint", "driven"),
        [
            (
                lap.world,
                lap_time(lap.best_lap_s, lap.penalty_s, 0),
                "?" if lap.resets is None else str(lap.resets),
                _seconds(lap.best_average_s),
                f"{'?' if lap.clean is None else lap.clean}/{lap.trials}",
                lap.checkpoint,
                lap.driven_at,
            )
            for lap in report.best
        ],
        left=("track", "best lap", "checkpoint", "driven"),
    )
    return Group(rows, said)


def _score(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.2f} s"


# Shows laps from fresh starts.


MOST_BARS = 12
BAR = 40
_BESIDE = 32
_WIDTHS_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


@fitted
def laps(columns: int, report: "LapsReport") -> RenderableType:
    reports = [report] if report.against is None else [report, report.against]
    times_s = [lap.lap_s for each in reports for lap in each.laps if lap.clean]
    parts: list[RenderableType] = []
    for each in reports:
        if len(reports) > 1:
            parts.append(_bold(each.name))
        parts.append(_histogram(each, _edges(times_s), min(BAR, columns - _BESIDE)))
        if each.ends:
            parts.append(_ends(each.ends))
    parts += [_bold(_summary(each)) for each in reports]
    parts += [Text(f"The best lap, {each.limit}.") for each in reports if each.limit]
    if report.comparison is not None:
        parts.append(_bold(report.comparison.verdict))
    return Group(*parts)


def _edges(times_s: Sequence[float]) -> list[float]:
    if not times_s:
        return []
    low, high = min(times_s), max(times_s)
    width = next((w for w in _WIDTHS_S if high - low < (MOST_BARS - 1) * w), _WIDTHS_S[-1])
    first, last = math.floor(low / width + 1e-9), math.floor(high / width + 1e-9)
    return [place * width for place in range(first, last + 2)]


def _histogram(report: "LapsReport", edges: Sequence[float], bar: int) -> Rows:
    times_s = [lap.lap_s for lap in report.laps if lap.clean]
    counts = [
        (f"{low:.1f} to {high:.1f} s", sum(low <= time_s + 1e-9 < high for time_s in times_s))
        for low, high in pairwise(edges)
    ]
    others = Counter(lap.status.lower() for lap in report.laps if not lap.clean)
    counts += others.most_common()
    most = max(count for _, count in counts)
    cells = [
        (name, str(count), "█" * math.ceil(max(bar, 1) * count / most)) for name, count in counts
    ]
    return Rows(("lap time", "laps", ""), cells, left=("lap time", ""))


def _ends(places: Sequence["EndPlace"]) -> Rows:
    return Rows(
        ("ended near", "of the lap", "laps", "how"),
        [
            (
                _span(place.first_waypoint, place.last_waypoint, "waypoint", "waypoints"),
                _span(round(place.from_percent), round(place.to_percent), "", "", " %"),
                str(place.laps),
                _how(place.statuses),
            )
            for place in places
        ],
        left=("ended near", "of the lap", "how"),
    )


def _how(statuses: dict[str, int]) -> str:
    if len(statuses) == 1:
        return next(iter(statuses)).lower()
    return ", ".join(f"{count} {status.lower()}" for status, count in statuses.items())


def _span(first: int, last: int, one: str, more: str, unit: str = "") -> str:
    """Such as "waypoint 7" or "7 to 9 %"."""
    words = f"{one} {first}" if first == last else f"{more} {first} to {last}"
    return words.strip() + unit


def _summary(report: "LapsReport") -> str:
    low, high = (round(100.0 * share) for share in report.clean_interval)
    laps = "lap" if report.driven == 1 else "laps"
    words = (
        f"{report.clean} of {report.driven} {laps} clean ({low} to {high} % with 95 % confidence)"
    )
    if report.clean == 1:
        words += f", {report.fastest_s:.2f} s"
    elif report.clean:
        words += (
            f", median {report.median_s:.2f} s, 90 % within {report.p90_s:.2f} s, "
            f"slowest {report.slowest_s:.2f} s, best {report.fastest_s:.2f} s"
        )
    driver = report.name if report.file is not None else f"checkpoint {report.name}"
    engine = "" if report.runtime == "torch" else f" with --runtime {report.runtime}"
    return f"{words}; {driver}{engine} on {report.world}, seed {report.seed}."


# Modes of `dr evaluate` with more than one evaluation.


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


def evaluate_many(settings: "Settings", asked: Many, *, quiet: bool) -> None:
    """Drive all models on all tracks, and show the table.

    Raises:
        typer.BadParameter: The other side of a comparison cannot be read.
    """
    try:
        rival = many_evaluations.Rival.parse(asked.against) if asked.against else None
    except BadValue as error:
        raise typer.BadParameter(
            f"--against {shown(asked.against)} {error.reason}. {error.remedy}"
        ) from None
    for world in asked.worlds or [settings.world_name]:
        bring_tracks(many_evaluations.on_world(settings, world))
    say = _say(quiet=quiet)
    plan = many_evaluations.prepare_many(
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
    report = many_evaluations.run_many(plan, say)
    console.warn(*report.notes)
    if asked.robust and len(report.rows) == 1 and report.robust:
        found = report.robust[0]
        console.emit(found, robust_grid(found))
        return
    if len(report.laps) == 1 and not any(row.reason for row in report.rows):
        sample = report.laps[0]
        console.emit(sample, laps(sample))
        return
    console.emit(report, models_table(report))
    if all(row.reason for row in report.rows):
        raise WorkerDied(
            "None of these models could be evaluated.", remedy="Read the reasons in the table."
        )


def evaluate_in_a_loop(settings: "Settings", seed: int | None, *, quiet: bool) -> None:
    say = _say(quiet=quiet)
    say("Evaluating each new checkpoint until Ctrl-C or dr-stop-evaluation.")
    report = evaluation_loop.run_loop(settings, seed=seed, on_progress=say, on_failure=console.warn)
    console.emit(report, best_laps(report))


def _say(*, quiet: bool) -> Callable[[str], None]:
    return (lambda text: None) if quiet else console.say


STARTER = "start-evaluation"
"""With -q it returns at once, as in DeepRacer-for-Cloud."""


ENGINES = ", ".join(get_args(Runtime))
KINDS = ".pb, .onnx, .xml, .tflite or a car's .tar.gz"

LOG = ("dr-logs evaluation -a", "show its whole log")
RESUME = ("dr-start-training --resume", "continue training")
STATUS = ("dr-status", "show how the training went")


@dataclass(frozen=True)
class Started:
    """An evaluation that runs in the background.

    Attributes:
        prefix: Model prefix.
        checkpoint: Name of the checkpoint that drives.
        pid: Process that supervises it.
        simtrace: Key of its trace in the bucket, once it has ended.
        metrics: Key of its metrics.
    """

    prefix: str
    checkpoint: str
    pid: int
    simtrace: str
    metrics: str


def evaluate(
    context: typer.Context,
    quiet: Annotated[
        bool,
        typer.Option(
            "-q",
            "--quiet",
            help="Print only the result. dr-start-evaluation -q runs in the background.",
        ),
    ] = False,
    clone: Annotated[
        bool, typer.Option("-c", "--clone", help="Evaluate a copy at <prefix>-E.")
    ] = False,
    checkpoint: Annotated[str | None, checkpoint_option("Drive", "--checkpoint")] = None,
    opponent_checkpoint: Annotated[
        str | None, checkpoint_option("Let the opponent drive", "--opp-checkpoint")
    ] = None,
    runtime: Annotated[
        Runtime | None,
        typer.Option(
            "--runtime",
            metavar="ENGINE",
            help=f"Run the policy with this engine: {ENGINES}.",
        ),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="FILE", help=f"Drive with this file instead: {KINDS}."),
    ] = None,
    metadata: Annotated[
        Path | None, typer.Option("--metadata", metavar="FILE", help="Its model_metadata.json.")
    ] = None,
    opponent_runtime: Annotated[
        Runtime | None,
        typer.Option(
            "--opp-runtime", metavar="ENGINE", help="Engine of the opponent in HEAD_TO_MODEL."
        ),
    ] = None,
    opponent_model: Annotated[
        Path | None,
        typer.Option("--opp-model", metavar="FILE", help="File of the opponent."),
    ] = None,
    opponent_metadata: Annotated[
        Path | None,
        typer.Option("--opp-metadata", metavar="FILE", help="Its model_metadata.json."),
    ] = None,
    start: options.Start = None,
    start_angle: options.StartAngle = None,
    start_position: options.StartPosition = None,
    reverse: options.Reverse = None,
    max_lap_seconds: options.MaxLapSeconds = None,
    average_laps: options.AverageLaps = None,
    seed: options.StartSeed = None,
    laps: options.Laps = None,
    against: options.Against = None,
    video: Annotated[
        bool | None,
        typer.Option("--video/--no-video", help="Make videos of it (DR_EVAL_SAVE_MP4)."),
    ] = None,
    robust: Annotated[
        bool,
        typer.Option(
            "--robust", help="Drive under a grid of disturbances, for a table and one score."
        ),
    ] = False,
    models: Annotated[
        str | None,
        typer.Option(
            "--models", metavar="PREFIXES", help='Compare models, as "team/*" or a,b with commas.'
        ),
    ] = None,
    worlds: Annotated[
        str | None,
        typer.Option("--worlds", metavar="A,B", help="On these tracks instead of DR_WORLD_NAME."),
    ] = None,
    loop: Annotated[
        bool, typer.Option("--loop", help="Evaluate each new checkpoint until stopped.")
    ] = False,
) -> None:
    """Drive evaluation laps with the model and report the result.

    Drives the checkpoint of --checkpoint, else of DR_EVAL_CHECKPOINT: a number, last, best, or a
    milestone such as first-lap (`dr-list-checkpoints` lists them). The other DR_EVAL_ settings
    describe the laps. The model is not changed, so it may be training at the same time.

    With --runtime the same laps are driven by another engine than PyTorch, such as the one of the
    car. With --model a file drives, without any model in the bucket; its model_metadata.json lies
    beside it, inside of it, or is named by --metadata.

    --video also makes videos: mp4/camera-pip/0-video.mp4 in the model shows the view from behind
    with what the car sees, camera-45degree and camera-topview the same without anything over it.
    `dr-video` makes others of the same laps.

    A policy drives every lap from the same start alike, so three laps say little. --laps 40 drives
    40 laps from starts that are spread over the track, a little beside the centre line and a little
    turned, and shows how many are clean, how fast they are, and where the others ended. Equal seeds
    give equal starts. --against tells whether another checkpoint is better by more than chance.

    --robust drives one lap from several starts under each level of light, glare, noise, latency,
    grip and more, and shows what broke the model. --models and --worlds drive several models on
    several tracks on all cores, and show the command that trains on from the best. --loop drives
    the newest checkpoint until Ctrl-C or dr-stop-evaluation, and keeps a table of best laps.

    dr-start-evaluation -q drives in the background: results are written to the bucket, messages to
    the log, and dr-stop-evaluation stops it.

    Example: dr-evaluate --model policy.onnx --json
    """
    if clone and model is not None:
        raise typer.BadParameter("-c copies a model in the bucket, but --model drives a file.")
    if checkpoint is not None and model is not None:
        raise typer.BadParameter("--checkpoint chooses one of a model, but --model drives a file.")
    chosen = parsed_checkpoint(checkpoint)
    opponent_chosen = parsed_checkpoint(opponent_checkpoint, "--opp-checkpoint")
    own = _source("", runtime, model, metadata) or PolicySource()
    opponent = _source("opp-", opponent_runtime, opponent_model, opponent_metadata)
    many = robust or models is not None or worlds is not None or laps is not None
    _check_modes(
        many=many,
        loop=loop,
        clone=clone,
        opponent=opponent,
        models=models,
        worlds=worlds,
        own=own,
        video=bool(video),
    )
    if against is not None and (laps is None or models is not None or worlds is not None):
        raise typer.BadParameter(
            "--against compares laps of two checkpoints on one track: write --laps 40 with it, and "
            "no --models or --worlds."
        )
    if laps is not None:
        given = start, start_angle, start_position, average_laps
        names = "--start", "--start-angle", "--start-position", "--average-laps"
        useless = [name for name, value in zip(names, given, strict=True) if value is not None]
        useless += ["--robust"] * robust
        if useless:
            raise typer.BadParameter(
                f"--laps draws the start of each lap on its own; leave out {', '.join(useless)}."
            )
    loaded = settings()
    if opponent_chosen is not None and loaded.race_type != "HEAD_TO_MODEL":
        raise typer.BadParameter("--opp-checkpoint needs DR_RACE_TYPE=HEAD_TO_MODEL.")
    loaded = options.with_options(
        loaded,
        DR_EVAL_CHECKPOINT=chosen,
        DR_EVAL_OPP_CHECKPOINT=opponent_chosen,
        DR_EVAL_START_OFFSET=start,
        DR_EVAL_START_ANGLE=start_angle,
        DR_EVAL_START_POSITION=start_position,
        DR_EVAL_REVERSE_DIRECTION=reverse,
        DR_EVAL_MAX_LAP_SECONDS=max_lap_seconds,
        DR_EVAL_AVERAGE_LAPS=average_laps,
        DR_EVAL_SAVE_MP4=video,
    )
    if many:
        asked = Many(
            options.listed(models),
            options.listed(worlds),
            robust,
            seed,
            own,
            laps or 0,
            against or "",
        )
        evaluate_many(loaded, asked, quiet=quiet)
        return
    bring_tracks(loaded)
    if loop:
        evaluate_in_a_loop(loaded, seed, quiet=quiet)
        return
    if quiet and context.info_name == STARTER:
        plan = evaluation_plan.prepare_evaluation(
            loaded, clone=clone, seed=seed, on_progress=console.say, own=own, opponent=opponent
        )
        record = evaluation.launch_evaluation(plan)
        started = Started(record.prefix, record.checkpoint, record.pid, plan.simtrace, plan.metrics)
        console.emit(started, None)
        return
    say = (lambda text: None) if quiet else console.say
    report = evaluation.evaluate(
        loaded, clone=clone, seed=seed, on_progress=say, own=own, opponent=opponent
    )
    console.warn(*report.notes)
    console.emit(report, show_evaluation(report))
    if not quiet:
        resume = [] if stopping.is_running(loaded.run) else [RESUME]
        more_laps = _more_laps(loaded.race_type, own, checkpoint)
        console.suggest([*more_laps, LOG, *resume, STATUS])


def _more_laps(race_type: str, own: PolicySource, checkpoint: str | None) -> list[tuple[str, str]]:
    if race_type == "HEAD_TO_MODEL" or own.file is not None:
        return []
    options = {"--checkpoint": checkpoint, "--runtime": own.runtime}
    given = "".join(f"{name} {value} " for name, value in options.items() if value is not None)
    return [(f"dr-evaluate {given}--laps 40", "see how it drives from other starts")]


def _check_modes(
    *,
    many: bool,
    loop: bool,
    clone: bool,
    opponent: PolicySource | None,
    models: str | None,
    worlds: str | None,
    own: PolicySource,
    video: bool,
) -> None:
    if loop and many:
        raise typer.BadParameter("--loop drives one model on one track; leave out the others.")
    if loop and own.file is not None:
        raise typer.BadParameter("--loop follows a model in the bucket, but --model drives a file.")
    if many and video:
        raise typer.BadParameter("--video films a single evaluation; film others with `dr-video`.")
    if (loop or many) and clone:
        raise typer.BadParameter("-c copies a model for a single evaluation only.")
    if many and opponent is not None:
        raise typer.BadParameter("An opponent drives in a single evaluation only.")
    if models is not None and own.file is not None:
        raise typer.BadParameter("--models names models in the bucket, but --model drives a file.")
    if models is not None and not options.listed(models):
        raise typer.BadParameter('--models is empty; name prefixes, as in --models "team/*".')
    if worlds is not None and not options.listed(worlds):
        raise typer.BadParameter("--worlds is empty; name tracks, as in --worlds oval,bean.")


def _source(
    which: str, runtime: Runtime | None, file: Path | None, metadata: Path | None
) -> PolicySource | None:
    if file is None and metadata is not None:
        raise typer.BadParameter(f"--{which}metadata belongs to --{which}model, which is missing.")
    if runtime is None and file is None:
        return None
    return PolicySource(runtime, _absolute(file), _absolute(metadata))


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.expanduser().absolute()
