"""`dr action-space`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drcli.base.errors import DrError, SettingsError
from drcli.cli import console, prompts
from drcli.cli.options import AsJson, Replace, force_option, prefix_option
from drcli.cli.views import action_space_view
from drcli.cli.views.layout import counted
from drcli.cli.working_folder import settings, working_folder

if TYPE_CHECKING:
    from drcli.modelfiles.action_choice import ChosenAction
    from drcli.modelfiles.action_space import ActionSpace
    from drcli.modelfiles.driven_actions import DrivenFile
    from drcli.models.action_space_change import ActionSpaceChange

app = typer.Typer(no_args_is_help=True, help="Draw, generate and write the actions of a model.")

_File = Annotated[
    Path | None,
    typer.Option(
        "--file", metavar="FILE", help="The model_metadata.json; that in custom_files/ if left out."
    ),
]
_Out = Annotated[
    Path | None,
    typer.Option("-o", "--out", metavar="PNG", help="Draw them into this picture."),
]
_Write = Annotated[
    bool, typer.Option("--write", help="Write them into model_metadata.json, after a question.")
]
_Force = Annotated[
    bool, force_option("Do not ask; replace the picture. The old file is kept as .bak.")
]
_Traces = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="TRACE",
        help="Simtrace files, logs or folders; those of the model in the bucket if left out.",
    ),
]
_Prefix = Annotated[
    str | None,
    prefix_option("Model whose traces are read; DR_LOCAL_S3_MODEL_PREFIX if left out."),
]


@app.command()
def show(
    file: _File = None, out: _Out = None, force: Replace = False, as_json: AsJson = False
) -> None:
    """Draw the actions of a model_metadata.json, here and as a picture.

    Example: dr-action-space show -o actions.png
    """
    from drcli.modelfiles.action_choice import ChosenAction
    from drcli.models.action_space_change import space_of

    path = file or _own_file()
    space = space_of(path)
    actions = [ChosenAction(*pair) for pair in space.values]
    _report(path, actions, space, (), None, out=out, write=False, force=force, as_json=as_json)


@app.command()
def generate(
    angles: Annotated[
        int, typer.Option("--angles", metavar="N", min=1, max=100, help="Number of angles.")
    ] = 5,
    speeds: Annotated[
        int, typer.Option("--speeds", metavar="M", min=1, max=100, help="Number of speeds.")
    ] = 2,
    max_angle: Annotated[
        float, typer.Option("--max-angle", min=0.5, max=30, help="Greatest angle, degrees.")
    ] = 30.0,
    max_speed: Annotated[
        float, typer.Option("--max-speed", min=0.1, max=4, help="Greatest speed, m/s.")
    ] = 1.0,
    min_speed: Annotated[
        float, typer.Option("--min-speed", min=0.1, max=4, help="Least speed of --continuous.")
    ] = 0.5,
    continuous: Annotated[
        bool, typer.Option("--continuous", help="Ranges instead of a list.")
    ] = False,
    file: _File = None,
    out: _Out = None,
    write: _Write = False,
    force: _Force = False,
    as_json: AsJson = False,
) -> None:
    """Generate N angles by M speeds, in the order of the DeepRacer console.

    Angles lie evenly from the right to the left, speeds are equal parts of the greatest. For each
    angle, all speeds follow one another. Without --write nothing is changed.

    Example: dr-action-space generate --angles 5 --speeds 3 --max-speed 2 --write
    """
    from drcli.modelfiles.action_choice import grid

    if continuous:
        if min_speed >= max_speed:
            raise typer.BadParameter(f"--min-speed {min_speed:g} is not below --max-speed.")
        ranges = {
            "steering_angle": {"low": -max_angle, "high": max_angle},
            "speed": {"low": min_speed, "high": max_speed},
        }
        _finish([], (), file, ranges=ranges, out=out, write=write, force=force, as_json=as_json)
        return
    made = grid(angles, speeds, max_angle=max_angle, max_speed=max_speed)
    notes = []
    if angles % 2 == 0:
        notes.append(f"With {angles} angles no action drives straight ahead.")
    if len({(action.steering_angle, action.speed) for action in made}) < len(made):
        raise typer.BadParameter("Some of these actions are equal: choose fewer angles or speeds.")
    _finish(made, notes, file, out=out, write=write, force=force, as_json=as_json)


@app.command()
def from_lap(
    traces: _Traces = None,
    actions: Annotated[
        int | None,
        typer.Option(
            "-k",
            "--actions",
            metavar="K",
            min=1,
            max=100,
            help="Number of actions; as few as the lap needs if left out.",
        ),
    ] = None,
    smooth: Annotated[
        int,
        typer.Option("--smooth", metavar="STEPS", min=1, max=45, help="Steps of the moving mean."),
    ] = 5,
    prefix: _Prefix = None,
    file: _File = None,
    out: _Out = None,
    write: _Write = False,
    force: _Force = False,
    as_json: AsJson = False,
) -> None:
    """Find the actions that the fastest recorded lap needs.

    Takes the moving mean of the requests, because the wheels follow with a lag: a zigzag becomes
    what it amounts to. K-means then finds the actions with the smallest squared error, where 5
    degrees count as 0.25 m/s. Without -k there are as many as it takes to have one that close for
    95 % of the steps.

    Example: dr-action-space from-lap evaluation-simtrace/0-iteration.csv -k 7 -o actions.png
    """
    from drcli.modelfiles.action_choice import close_share, needed, smoothed
    from drcli.modelfiles.driven_actions import complete_laps

    files = _driven(traces, prefix)
    laps = complete_laps(files)
    if not laps:
        raise SettingsError(
            f"There is no complete lap without leaving the track in {_named(files)}.",
            remedy="Name a trace with a complete lap, or use `dr-action-space from-histogram`.",
        )
    lap = laps[0]
    pairs = smoothed(lap.pairs, smooth)
    found = needed(pairs, actions)
    notes = [
        f"From the fastest of {counted(len(laps), 'clean lap')}: {lap.seconds:.2f} s, "
        f"{len(lap.pairs)} steps, episode {lap.episode} of {lap.file}.",
        f"{close_share(pairs, found):.0%} of its steps have an action within 5 degrees and "
        "0.25 m/s.",
    ]
    _finish(found, notes, file, out=out, write=write, force=force, as_json=as_json)


@app.command()
def from_histogram(
    traces: _Traces = None,
    angles: Annotated[
        int, typer.Option("--angles", metavar="N", min=1, max=100, help="Cells of angles.")
    ] = 7,
    speeds: Annotated[
        int, typer.Option("--speeds", metavar="M", min=1, max=100, help="Cells of speeds.")
    ] = 3,
    least: Annotated[
        float,
        typer.Option("--least", metavar="SHARE", min=0, max=1, help="Least share of an action."),
    ] = 0.02,
    prefix: _Prefix = None,
    file: _File = None,
    out: _Out = None,
    write: _Write = False,
    force: _Force = False,
    as_json: AsJson = False,
) -> None:
    """Count the actions of recorded drives, and keep those that were used.

    Discrete actions are counted one by one. Continuous ones are counted in cells between the least
    and the greatest that were requested; an action is the mean of its cell.

    Example: dr-action-space from-histogram training-simtrace/ --least 0.05
    """
    from drcli.modelfiles.action_choice import used

    files = _driven(traces, prefix)
    pairs = [step.pair for each in files for step in each.steps]
    found = used(pairs, angles=angles, speeds=speeds, least=least)
    covered = sum(action.share or 0.0 for action in found)
    notes = [f"From {len(pairs):,} steps in {_named(files)}.", f"They cover {covered:.0%} of them."]
    _finish(found, notes, file, out=out, write=write, force=force, as_json=as_json)


def _finish(
    actions: Sequence["ChosenAction"],
    notes: Sequence[str],
    file: Path | None,
    *,
    ranges: dict[str, Any] | None = None,
    out: Path | None,
    write: bool,
    force: bool,
    as_json: bool,
) -> None:
    from drcli.models.action_space_change import plan_change

    listed = [{"steering_angle": each.steering_angle, "speed": each.speed} for each in actions]
    path = file or _own_file()
    change = plan_change(path, listed if ranges is None else ranges)
    notes = [*notes, *change.warnings]
    _report(
        *(path, actions, change.after, notes, change),
        out=out,
        write=write,
        force=force,
        as_json=as_json,
    )


def _report(
    path: Path,
    actions: Sequence["ChosenAction"],
    space: "ActionSpace",
    notes: Sequence[str],
    change: "ActionSpaceChange | None",
    *,
    out: Path | None,
    write: bool,
    force: bool,
    as_json: bool,
) -> None:
    picture = None if out is None else _drawn(out, space, actions, path, force=force)
    differs = change is not None and change.before != change.after
    about = _about_the_model(space) if change is not None and differs else ""
    notes = [*notes, *([about] if about else [])]
    backup = None
    written = False
    if write and change is not None and differs:
        from drcli.models.action_space_change import write_change

        if not force and (change.before is not None or about):
            what = "has other actions" if change.before is not None else "does not exist yet"
            prompts.agree(f"{path} {what}. {about} Replace them?".replace("  ", " "), yes=False)
        written = write_change(change)
        backup = str(change.backup) if written and change.backup is not None else None
    from drcli.models.action_space_change import ActionSpaceReport

    report = ActionSpaceReport(
        str(path),
        tuple(actions),
        space.low,
        space.high,
        tuple(notes),
        differs,
        written,
        backup,
        picture,
    )
    console.emit(report, action_space_view.actions(report), as_json=as_json)
    if differs and not written:
        console.say("Nothing was written: add --write to put them into model_metadata.json.")


def _drawn(
    out: Path,
    space: "ActionSpace",
    actions: Sequence["ChosenAction"],
    path: Path,
    *,
    force: bool,
) -> str:
    from drcli.base.atomic_file import rewrite
    from drcli.base.replaceable import refuse_replacing
    from drcli.rewards.action_picture import draw_actions

    refuse_replacing(out, force=force)
    shares = [action.share for action in actions if action.share is not None]
    rewrite(out, draw_actions(space, shares, f"Actions for {path.name}"))
    return str(out)


def _own_file() -> Path:
    if not (working_folder() / "run.env").is_file():
        return working_folder() / "custom_files" / "model_metadata.json"
    return settings().custom_files_dir / "model_metadata.json"


def _about_the_model(new: "ActionSpace") -> str:
    from drcli.models.action_space_change import sentence_about, trained_with
    from drcli.store.connect import open_running_bucket

    if not (working_folder() / "run.env").is_file():
        return ""
    loaded = settings()
    try:
        bucket = open_running_bucket(loaded.storage)
        if bucket is None:
            return ""
        checkpoints, trained = trained_with(loaded, bucket)
    except DrError as error:
        return f"Whether {loaded.model_prefix} has checkpoints could not be looked up: {error}"
    model = f"s3://{bucket.name}/{loaded.model_prefix}"
    return sentence_about(model, checkpoints, trained, new)


def _driven(paths: list[Path] | None, prefix: str | None) -> list["DrivenFile"]:
    from drcli.models.trace_files import traces_in_folders, traces_of_model

    if paths:
        files = traces_in_folders(paths)
    else:
        from drcli.models.transfer_buckets import bucket_to_look_at

        loaded = settings()
        bucket = bucket_to_look_at(loaded.transfer, upload=False)
        files = traces_of_model(bucket, prefix or loaded.model_prefix)
    skipped = sum(file.skipped for file in files)
    if skipped:
        console.warn(f"{skipped:,} lines of {_named(files)} could not be read and were skipped.")
    return files


def _named(files: Sequence["DrivenFile"]) -> str:
    more = f" and {len(files) - 1:,} more" if len(files) > 1 else ""
    return f"{files[0].name}{more}"
