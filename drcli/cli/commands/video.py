"""`dr video`."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import BadValue, SettingsError
from drcli.base.files import refuse_new_file, refuse_replacing
from drcli.base.installation import lazy_imports
from drcli.base.processes import until_sigterm
from drcli.cli import terminal
from drcli.cli.evaluation_options import with_options
from drcli.cli.options import Replace, checkpoint_option, parsed_checkpoint, world_option
from drcli.cli.show import show
from drcli.cli.working_folder import settings_for_files, settings_or_defaults
from drcli.config.value_types import colour
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.view.video.encode import GIF_FPS, require_encoder

if TYPE_CHECKING:
    from drcli.bucket.bucket import Bucket
    from drcli.config.settings import Settings
    from drcli.view.video.trace_source import FoundTrace

with lazy_imports():
    from drcli.cli import fetch_tracks
    from drcli.run import evaluation as run_evaluation
    from drcli.transfer import transfer_buckets
    from drcli.view.video import knob_strip, make_video, recorded_lap, trace_source, video_job


SIZES = ("640x480", "1280x720")
RENDERERS = ("raycast", "mujoco")

_WHICH, _HOW = "What to film", "How to film"


def video(
    context: typer.Context,
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="[MODEL|FILE]",
            help="Prefix of a model, or a simtrace .csv file; the model of run.env if left out.",
        ),
    ] = None,
    evaluation: Annotated[
        str | None,
        typer.Option(
            "--evaluation",
            metavar="STAMP",
            help="Film this stored evaluation: fourteen digits, last, or opponent.",
            rich_help_panel=_WHICH,
        ),
    ] = None,
    iteration: Annotated[
        int | None,
        typer.Option(
            "-i",
            "--iteration",
            metavar="N",
            min=0,
            help="Film the training of this iteration.",
            rich_help_panel=_WHICH,
        ),
    ] = None,
    worker: Annotated[
        int,
        typer.Option(
            "--worker",
            metavar="K",
            min=0,
            help="With --iteration: of this simulation worker.",
            rich_help_panel=_WHICH,
        ),
    ] = 0,
    checkpoint: Annotated[
        str | None, checkpoint_option("Drive a lap now, and film that, with")
    ] = None,
    episode: Annotated[
        str,
        typer.Option(
            "-e",
            "--episode",
            metavar="N",
            help="The number of an episode, best, or all.",
            rich_help_panel=_WHICH,
        ),
    ] = "best",
    ghosts: Annotated[
        int,
        typer.Option(
            "--ghosts",
            metavar="N",
            min=0,
            max=4,
            help="Let so many other laps of the trace drive along.",
            rich_help_panel=_WHICH,
        ),
    ] = 0,
    ghost: Annotated[
        list[str] | None,
        typer.Option(
            "--ghost",
            metavar="FILE|STAMP",
            help="Let the best lap of this trace drive along. Can be given again.",
            rich_help_panel=_WHICH,
        ),
    ] = None,
    world: Annotated[
        str | None, world_option("Track of the trace, if nothing else names it.", "-w")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="Write this .mp4 or .gif file."),
    ] = None,
    gif: Annotated[bool, typer.Option("--gif", help="Make a GIF instead of an MP4.")] = False,
    size: Annotated[
        str,
        typer.Option("--size", metavar="WxH", help="640x480 or 1280x720.", rich_help_panel=_HOW),
    ] = SIZES[0],
    fps: Annotated[
        int,
        typer.Option(
            "--fps",
            metavar="N",
            min=5,
            max=60,
            help="Frames per second; cars move evenly at each.",
            rich_help_panel=_HOW,
        ),
    ] = 15,
    seconds: Annotated[
        int | None,
        typer.Option(
            "--seconds",
            metavar="S",
            min=0,
            help="End the film after so many seconds; 0 for no limit. 300 if left out, and 10 "
            "after the car came further.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            "--policy",
            metavar="CHECKPOINT|FILE",
            help="Show the probabilities of this policy, or none.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    metadata: Annotated[
        Path | None,
        typer.Option(
            "--metadata",
            metavar="FILE",
            help="model_metadata.json of the file of --policy.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    explain: Annotated[
        bool,
        typer.Option("--explain", help="Show which pixels moved the action.", rich_help_panel=_HOW),
    ] = False,
    renderer: Annotated[
        str,
        typer.Option(
            "--renderer",
            metavar="NAME",
            help="raycast, or mujoco, which needs OpenGL.",
            rich_help_panel=_HOW,
        ),
    ] = RENDERERS[0],
    color: Annotated[
        str | None,
        typer.Option(
            "--color",
            metavar="NAME",
            help="Colour of the car instead of DR_CAR_COLOR.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    racer: Annotated[
        str | None,
        typer.Option(
            "--racer",
            metavar="NAME",
            help="Name on the video instead of DR_RACER_NAME.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    knobs: Annotated[
        bool,
        typer.Option(
            "--knobs",
            help="Draw what domain randomisation does to the picture instead: a PNG, by setting.",
            rich_help_panel=_WHICH,
        ),
    ] = False,
    force: Replace = False,
) -> None:
    """Make a video of a lap: the view from behind, what the car sees, map, time, probabilities.

    Films the newest stored evaluation of the model, its best lap; of a model without any, its last
    race as an opponent, which --evaluation opponent names for any model. --checkpoint drives a new
    lap with a checkpoint first, --iteration takes a lap of the training, and a file is any simtrace
    of drcli, DeepRacer-for-Cloud or a console. The track is found by its length if nothing names
    it.

    The film is computed from the recorded poses, so the same lap can be filmed again at another
    size, with ghosts of other laps, or with --explain, which colours the pixels that moved the
    action. An MP4 needs the extra [video]; a GIF does not.

    --knobs films nothing: it writes knobs.png, where each setting of domain randomisation that
    changes the picture has a row, the usual frame and what episodes draw, as the network sees it.
    A setting that is off is shown with an example.

    Example: dr-video --checkpoint best --size 1280x720 -o lap.mp4
    """
    if knobs:
        _draw_knobs(context, world, out or Path("knobs.png"), force=force)
        return
    _refuse_clashes(what, evaluation, iteration, checkpoint, worker)
    if size not in SIZES:
        raise typer.BadParameter(f"--size {size:.20} is not one of {', '.join(SIZES)}.")
    if renderer not in RENDERERS:
        raise typer.BadParameter(f"--renderer {renderer:.20} is not one of raycast, mujoco.")
    if out is not None and gif and out.suffix.lower() != ".gif":
        raise typer.BadParameter(f"--gif makes a GIF, but --out {out} does not end in .gif.")
    chosen = parsed_checkpoint(checkpoint)
    loaded = settings_for_files([] if what is None else [what])

    if color is not None:
        try:
            color = colour(color)
        except BadValue as error:
            raise typer.BadParameter(f"--color {color:.40} {error}. {error.remedy}") from None
    is_gif = gif or (out is not None and out.suffix.lower() == ".gif")
    ending = ".gif" if is_gif else ".mp4"
    if not is_gif:
        require_encoder()
    if out is not None:
        make_video.refuse_file(out, force=force)
    else:
        refuse_new_file(Path(f"lap{ending}"))
    opened: list[Bucket] = []

    def bucket() -> "Bucket":
        if not opened:
            opened.append(transfer_buckets.bucket_to_look_at(loaded.transfer, upload=False))
        return opened[0]

    if chosen is not None:
        evaluation = _drive(loaded, str(chosen), what)
    trace = _trace(loaded, bucket, what, evaluation, iteration, worker)
    path = out or _free_name(trace.stem + ending)
    video_options = make_video.VideoOptions(
        episode=episode,
        size=size,
        fps=min(fps, GIF_FPS) if is_gif else fps,
        ghosts=ghosts,
        renderer="mujoco" if renderer == "mujoco" else "raycast",
        color=color or "",
        racer=racer or "",
        explain=explain,
        most_seconds=(make_video.USUAL_SECONDS if seconds is None else seconds) or None,
        stuck_seconds=make_video.STUCK_SECONDS if seconds is None else None,
    )
    make_video.refuse_file(path, force=force)
    doing = make_video.plan_of(trace, video_options, [path])
    stopped = until_sigterm("The video was stopped; no file was written.", "Run it again.")
    with stopped, terminal.waiting(doing):
        report = video_job.make_video(
            video_job.Defaults.of(loaded.model, loaded.race),
            bucket,
            trace,
            video_options,
            [("film", path)],
            world=world,
            policy=video_job.PolicyOptions(policy, metadata, iteration),
            ghosts=ghost or [],
            on_progress=terminal.say,
        )
    terminal.warn(*report.notes)
    show(report)


def _draw_knobs(context: typer.Context, world: str | None, path: Path, *, force: bool) -> None:
    for name, value in context.params.items():
        source = context.get_parameter_source(name)
        if name in ("knobs", "world", "out", "force") or source is None:
            continue
        if source.name == "COMMANDLINE":
            option = str(value) if name == "what" else f"--{name}"
            raise typer.BadParameter(f"--knobs films no lap: leave out {option:.60}.")
    if path.suffix.lower() != ".png":
        raise typer.BadParameter(f"--knobs makes a PNG, but --out {path} does not end in .png.")
    refuse_replacing(path, force=force)
    loaded = with_options(settings_or_defaults(), DR_WORLD_NAME=world)
    fetch_tracks.bring_tracks(loaded)
    track = recorded_lap.load_world(loaded.race.world_name, loaded.race.tracks_folder)
    show(knob_strip.draw_knobs(loaded.race, track, path))


def _refuse_clashes(
    what: str | None,
    evaluation: str | None,
    iteration: int | None,
    checkpoint: str | None,
    worker: int,
) -> None:
    given = [
        name
        for name, value in (
            ("--evaluation", evaluation),
            ("--iteration", iteration),
            ("--checkpoint", checkpoint),
        )
        if value is not None
    ]
    if len(given) > 1:
        raise typer.BadParameter(f"{given[0]} and {given[1]} each name a trace; give one of them.")
    if given and what is not None and _is_file(what):
        raise typer.BadParameter(f"{given[0]} belongs to a model, but {what} is a file.")
    if worker and iteration is None:
        raise typer.BadParameter("--worker belongs to --iteration.")


def _is_file(what: str) -> bool:
    return what.endswith(".csv") or what.startswith((".", "/", "~")) or Path(what).exists()


def _trace(
    loaded: "Settings",
    bucket: "Callable[[], Bucket]",
    what: str | None,
    evaluation: str | None,
    iteration: int | None,
    worker: int,
) -> "FoundTrace":
    if what is not None and _is_file(what):
        return trace_source.trace_of_file(Path(what).expanduser())
    prefix = loaded.model_prefix if what is None else what.rstrip("/")
    if iteration is not None:
        return trace_source.trace_of_iteration(ModelStore(bucket(), prefix), iteration, worker)
    stamp = None if evaluation in (None, "last") else evaluation
    return trace_source.trace_of_evaluation(ModelStore(bucket(), prefix), stamp)


def _drive(loaded: "Settings", checkpoint: str, what: str | None) -> str:
    if what is not None and what.rstrip("/") != loaded.model_prefix:
        prefix = what.rstrip("/")
        loaded = loaded.replaced(model_prefix=prefix, metrics_prefix=keys.metrics_prefix(prefix))
    loaded = with_options(
        loaded,
        DR_EVAL_CHECKPOINT=checkpoint,
        DR_EVAL_NUMBER_OF_TRIALS=1,
        DR_EVAL_SAVE_MP4=False,
    )
    fetch_tracks.bring_tracks(loaded)
    report = run_evaluation.evaluate(loaded, on_progress=terminal.say)
    terminal.warn(*report.notes)
    return report.simtrace.rpartition("/evaluation-simtrace/")[0].rpartition("evaluation-")[2]


def _free_name(name: str) -> Path:
    path = Path(name)
    for number in range(2, 1001):
        if not path.exists():
            return path
        path = Path(name).with_stem(f"{Path(name).stem}-{number}")
    raise SettingsError(f"{name} exists a thousand times.", remedy="Name a file with --out.")
