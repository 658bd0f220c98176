"""`dr evaluate`, also `dr-start-evaluation`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import typer

from drcli.base.errors import BadValue, WorkerDied, shown
from drcli.base.installation import lazy_imports
from drcli.cli import evaluation_options as options
from drcli.cli import terminal
from drcli.cli.fetch_tracks import bring_tracks
from drcli.cli.options import checkpoint_option, parsed_checkpoint
from drcli.cli.show import show
from drcli.cli.working_folder import settings
from drcli.records.evaluation_task import PolicySource, Runtime

with lazy_imports():
    from drcli.run import (
        evaluation,
        evaluation_loop,
        evaluation_plan,
        many_evaluations,
        stopping,
    )


STARTER = "start-evaluation"
"""With -q it returns at once, as in DeepRacer-for-Cloud."""


ENGINES = ", ".join(get_args(Runtime))
KINDS = ".pb, .onnx, .xml, .tflite or a car's .tar.gz"

LOG = ("dr-logs evaluation -a", "show its whole log")
RESUME = ("dr-start-training --resume", "continue training")
STATUS = ("dr-status", "show how the training went")


@dataclass(frozen=True)
class Started:
    """An evaluation that runs in the background."""

    prefix: Annotated[str, "Model prefix."]
    checkpoint: Annotated[str, "Name of the checkpoint that drives."]
    pid: Annotated[int, "Process that supervises it."]
    simtrace: Annotated[str, "Key of its trace in the bucket, once it has ended."]
    metrics: Annotated[str, "Key of its metrics."]


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
        typer.Option(
            "--worlds",
            metavar="A,B",
            help="On these tracks instead of DR_WORLD_NAME, also zoo:N.",
        ),
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
    if context.info_name == STARTER:
        stopping.refuse_second_evaluation(loaded.directory, loaded.run_id)
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
    say = (lambda text: None) if quiet else terminal.say
    if many:
        rival = _rival(against)
        tracks = many_evaluations.worlds_of(loaded, worlds or "")
        for world in tracks or [loaded.world_name]:
            bring_tracks(many_evaluations.on_world(loaded, world))
        table = many_evaluations.prepare_many(
            loaded,
            models=options.listed(models),
            worlds=tracks,
            robust=robust,
            fresh_laps=laps or 0,
            rival=rival,
            seed=seed,
            own=own,
            on_progress=say,
        )
        _show_many(many_evaluations.run_many(table, say), robust=robust)
        return
    bring_tracks(loaded)
    if loop:
        say("Evaluating each new checkpoint until Ctrl-C or dr-stop-evaluation.")
        show(evaluation_loop.run_loop(loaded, seed=seed, on_progress=say, on_failure=terminal.warn))
        return
    if quiet and context.info_name == STARTER:
        plan = evaluation_plan.prepare_evaluation(
            loaded, clone=clone, seed=seed, on_progress=terminal.say, own=own, opponent=opponent
        )
        record = evaluation.launch_evaluation(plan)
        started = Started(record.prefix, record.checkpoint, record.pid, plan.simtrace, plan.metrics)
        terminal.emit(started, None)
        return
    report = evaluation.evaluate(
        loaded, clone=clone, seed=seed, on_progress=say, own=own, opponent=opponent
    )
    terminal.warn(*report.notes)
    show(report)
    if not quiet:
        resume = [] if stopping.is_running(loaded.run) else [RESUME]
        more_laps = _more_laps(loaded.race_type, own, checkpoint)
        terminal.suggest([*more_laps, LOG, *resume, STATUS])


def _rival(against: str | None) -> "many_evaluations.Rival | None":
    try:
        return many_evaluations.Rival.parse(against) if against else None
    except BadValue as error:
        raise typer.BadParameter(
            f"--against {shown(against or '')} {error.reason}. {error.remedy}"
        ) from None


def _show_many(report: "many_evaluations.TableReport", *, robust: bool) -> None:
    terminal.warn(*report.notes)
    if robust and len(report.rows) == 1 and report.robust:
        show(report.robust[0])
    elif len(report.laps) == 1 and not any(row.reason for row in report.rows):
        show(report.laps[0])
    else:
        show(report)
        if all(row.reason for row in report.rows):
            raise WorkerDied(
                "None of these models could be evaluated.", remedy="Read the reasons in the table."
            )


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
