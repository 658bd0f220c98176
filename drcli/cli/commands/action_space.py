"""`dr action-space`."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from rich.console import Group, RenderableType

from drcli.base.errors import DrError, SettingsError
from drcli.base.files import is_left_behind, read_regular, refuse_replacing, rewrite
from drcli.base.installation import lazy_imports
from drcli.base.png_picture import INK, png
from drcli.base.report import counted
from drcli.bucket.bucket import ObjectMissing
from drcli.cli import prompts, terminal
from drcli.cli.options import Replace, force_option, prefix_option
from drcli.cli.show import drawn, fitted
from drcli.cli.working_folder import settings, working_folder
from drcli.model.files.action_choice import (
    ChosenAction,
    DrivenFile,
    close_share,
    complete_laps,
    needed,
    read_steps,
    smoothed,
    used,
)
from drcli.model.files.action_space import ActionSpace
from drcli.model.model_store import ModelStore
from drcli.model.traces import traces_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes

    from drcli.transfer.action_space_change import ActionSpaceChange, ActionSpaceReport

with lazy_imports():
    from drcli.bucket import connect
    from drcli.model.files import action_choice
    from drcli.transfer import action_space_change, transfer_buckets

# Shows action spaces.


_WIDEST, _NARROWEST = 61, 31
_SPREAD = 2.0
"""A car steers by 30 degrees only."""

_ASPECT = 0.5
_DIGITS = "0123456789abcdefghijklmnopqrstuvwxyz"


@fitted
def show_actions(columns: int, report: "ActionSpaceReport") -> RenderableType:
    return Group(*picture(report, columns), "", drawn(report))


def picture(report: "ActionSpaceReport", columns: int) -> list[str]:
    """Steering is the direction, speed the distance from the bottom."""
    wide = max(min(_WIDEST, columns - 2), _NARROWEST)
    if wide % 2 == 0:
        wide -= 1
    if report.low and report.high:
        corners = [report.low, report.high]
    else:
        corners = [(action.steering_angle, action.speed) for action in report.actions]
    fastest = max((speed for _, speed in corners), default=1.0)
    widest = max(30.0, *(abs(angle) for angle, _ in corners)) * _SPREAD
    reach = wide // 2 / max(math.sin(math.radians(min(widest, 90.0))), 0.1)
    high = round(reach * _ASPECT)
    grid = [[" "] * wide for _ in range(high + 1)]

    def put(angle: float, speed: float, mark: str) -> None:
        turn = math.radians(angle * _SPREAD)
        column = round(wide // 2 - reach * speed / fastest * math.sin(turn))
        row = round(high - reach * _ASPECT * speed / fastest * math.cos(turn))
        if 0 <= column < wide and 0 <= row <= high:
            grid[row][column] = mark if grid[row][column] in " .:" or mark != "." else "+"

    for part in (0.5, 1.0):
        for step in range(-60, 61):
            put(widest / _SPREAD * step / 60, fastest * part, ".")
    if report.low and report.high:
        for a in range(81):
            for s in range(41):
                angle = report.low[0] + (report.high[0] - report.low[0]) * a / 80
                put(angle, report.low[1] + (report.high[1] - report.low[1]) * s / 40, "#")
    for number, action in enumerate(report.actions):
        put(action.steering_angle, action.speed, _DIGITS[number] if number < 36 else "*")
    put(0.0, 0.0, "^")
    lines = ["".join(row).rstrip() for row in grid]
    side = f"left{'':{max(wide - 9, 1)}}right"
    return [
        *lines,
        side,
        f"Outer arc {fastest:g} m/s, inner arc {fastest / 2:g} m/s; angles twice as wide.",
    ]


# Draws an action space: steering as direction, speed as distance.


_BLUE = "#0072b2"
_MOST_LABELS = 40
_LEAST_WIDTH_DEG = 30.0


def draw_actions(space: ActionSpace, shares: Sequence[float], title: str) -> bytes:
    """`shares` of the steps, 0 .. 1, may be empty."""
    corners = [space.low, space.high] if space.low and space.high else space.values
    widest = max(_LEAST_WIDTH_DEG, *(abs(angle) for angle, _ in corners))
    fastest = max(speed for _, speed in corners)

    def draw(figure: "Figure") -> None:
        figure.suptitle(title, x=0.02, ha="left", color=INK)
        axes = cast("PolarAxes", figure.add_subplot(projection="polar"))
        axes.set_theta_zero_location("N")
        axes.set_thetamin(-widest - 3.0)
        axes.set_thetamax(widest + 3.0)
        axes.set_rlim(0.0, 1.12 * fastest)
        axes.set_xticks([math.radians(angle) for angle in _ticks(widest)])
        axes.set_xticklabels([_angle(angle) for angle in _ticks(widest)])
        axes.set_xlabel("speed, m/s; steering, degrees, L left, R right", color=INK)
        if space.low and space.high:
            _draw_ranges(axes, space.low, space.high)
        else:
            _draw_list(axes, space.values, shares)

    return png(draw, (7.0, 7.0))


def _draw_list(
    axes: "Axes", actions: Sequence[tuple[float, float]], shares: Sequence[float]
) -> None:
    sizes: Any = [60.0 + 1800.0 * share for share in shares] or 90.0
    angles = [math.radians(angle) for angle, _ in actions]
    speeds = [speed for _, speed in actions]
    for angle, speed in zip(angles, speeds, strict=True):
        axes.plot([angle, angle], [0.0, speed], color=_BLUE, alpha=0.25, linewidth=1.0)
    axes.scatter(angles, speeds, s=sizes, color=_BLUE, alpha=0.75, zorder=3)
    if len(actions) > _MOST_LABELS:
        return
    for number, (angle, speed) in enumerate(zip(angles, speeds, strict=True)):
        axes.annotate(
            str(number),
            (angle, speed),
            xytext=(0, 7),
            textcoords="offset points",
            ha="center",
            color=INK,
            fontsize=9,
        )


def _draw_ranges(
    axes: "Axes", low: tuple[float, float], high: tuple[float, float], parts: int = 60
) -> None:
    turn = [math.radians(low[0] + (high[0] - low[0]) * k / parts) for k in range(parts + 1)]
    axes.fill_between(turn, low[1], high[1], color=_BLUE, alpha=0.35)


def _ticks(widest: float) -> list[float]:
    step = 10.0 if widest <= 30.0 else 15.0
    count = math.floor(widest / step)
    return [step * k for k in range(-count, count + 1)]


def _angle(angle: float) -> str:
    side = "L" if angle > 0 else "R" if angle < 0 else ""
    return f"{abs(angle):g}°{side}"


# Finds traces: in files and folders, or a model's.


NEWEST_TRACES = 20
"""Older training traces show a worse driver."""

_MOST_FILES = 5_000


def traces_in_folders(paths: Iterable[Path]) -> list[DrivenFile]:
    """Read files and the `.csv` in folders; SettingsError without a trace."""
    found: list[DrivenFile] = []
    for path in paths:
        if not path.is_dir():
            found.append(read_steps(_content(path), str(path)))
            continue
        inside = []
        files = (file for file in path.rglob("*.csv") if not is_left_behind(file.name))
        for file in sorted(files)[:_MOST_FILES]:
            try:
                inside.append(read_steps(_content(file), str(file)))
            except SettingsError:
                continue
        if not inside:
            raise SettingsError(
                f"{path} holds no trace of a drive.",
                remedy="Name a folder such as training-simtrace/, or a file in it.",
            )
        found += inside
    return found


def traces_of_model(model: ModelStore) -> list[DrivenFile]:
    """Of all evaluations and the newest training; SettingsError without any."""
    own = traces_of(model).objects  # none of a model inside it
    listed = [info.key for info in own if info.key.endswith(".csv")]
    training = [key for key in listed if "/training-simtrace/" in key[len(model.prefix) :]]
    evaluation = [key for key in listed if "/evaluation-simtrace/" in key[len(model.prefix) :]]
    training.sort(key=_iteration)
    found = []
    for key in [*evaluation, *training[-NEWEST_TRACES:]]:
        try:
            found.append(read_steps(model.bucket.get(key), key))
        except (SettingsError, ObjectMissing):
            continue  # half written, or deleted since it was listed
    if not found:
        raise SettingsError(
            f"{model.url} has no trace of a drive.",
            remedy="Train or evaluate the model first, or name a trace file.",
        )
    return found


def _iteration(key: str) -> tuple[int, str]:
    number = key.rpartition("/")[2].partition("-")[0]
    return (int(number) if number.isdecimal() else -1), key


def _content(path: Path) -> bytes:
    try:
        return read_regular(path)
    except OSError as error:
        raise SettingsError(
            f"{path} cannot be read: {error.strerror or error}.",
            remedy="Name a simtrace file, a log, or a folder with such files.",
        ) from None


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
def show(file: _File = None, out: _Out = None, force: Replace = False) -> None:
    """Draw the actions of a model_metadata.json, here and as a picture.

    Example: dr-action-space show -o actions.png
    """
    path = file or _own_file()
    space = action_space_change.space_of(path)
    actions = [ChosenAction(*pair) for pair in space.values]
    _report(path, actions, space, (), None, out=out, write=False, force=force)


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
) -> None:
    """Generate N angles by M speeds, in the order of the DeepRacer console.

    Angles lie evenly from the right to the left, speeds are equal parts of the greatest. For each
    angle, all speeds follow one another. Without --write nothing is changed.

    Example: dr-action-space generate --angles 5 --speeds 3 --max-speed 2 --write
    """
    if continuous:
        if min_speed >= max_speed:
            raise typer.BadParameter(f"--min-speed {min_speed:g} is not below --max-speed.")
        ranges = {
            "steering_angle": {"low": -max_angle, "high": max_angle},
            "speed": {"low": min_speed, "high": max_speed},
        }
        _finish([], (), file, ranges=ranges, out=out, write=write, force=force)
        return
    made = action_choice.grid(angles, speeds, max_angle=max_angle, max_speed=max_speed)
    notes = []
    if angles % 2 == 0:
        notes.append(f"With {angles} angles no action drives straight ahead.")
    if len({(action.steering_angle, action.speed) for action in made}) < len(made):
        raise typer.BadParameter("Some of these actions are equal: choose fewer angles or speeds.")
    _finish(made, notes, file, out=out, write=write, force=force)


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
) -> None:
    """Find the actions that the fastest recorded lap needs.

    Takes the moving mean of the requests, because the wheels follow with a lag: a zigzag becomes
    what it amounts to. K-means then finds the actions with the smallest squared error, where 5
    degrees count as 0.25 m/s. Without -k there are as many as it takes to have one that close for
    95 % of the steps.

    Example: dr-action-space from-lap evaluation-simtrace/0-iteration.csv -k 7 -o actions.png
    """
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
    _finish(found, notes, file, out=out, write=write, force=force)


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
) -> None:
    """Count the actions of recorded drives, and keep those that were used.

    Discrete actions are counted one by one. Continuous ones are counted in cells between the least
    and the greatest that were requested; an action is the mean of its cell.

    Example: dr-action-space from-histogram training-simtrace/ --least 0.05
    """
    files = _driven(traces, prefix)
    pairs = [step.pair for each in files for step in each.steps]
    found = used(pairs, angles=angles, speeds=speeds, least=least)
    covered = sum(action.share or 0.0 for action in found)
    notes = [f"From {len(pairs):,} steps in {_named(files)}.", f"They cover {covered:.0%} of them."]
    _finish(found, notes, file, out=out, write=write, force=force)


def _finish(
    actions: Sequence["ChosenAction"],
    notes: Sequence[str],
    file: Path | None,
    *,
    ranges: dict[str, Any] | None = None,
    out: Path | None,
    write: bool,
    force: bool,
) -> None:
    listed = [{"steering_angle": each.steering_angle, "speed": each.speed} for each in actions]
    path = file or _own_file()
    change = action_space_change.plan_change(path, listed if ranges is None else ranges)
    notes = [*notes, *change.warnings]
    _report(
        *(path, actions, change.after, notes, change),
        out=out,
        write=write,
        force=force,
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
) -> None:
    picture = None if out is None else _drawn(out, space, actions, path, force=force)
    differs = change is not None and change.before != change.after
    about = _about_the_model(space) if change is not None and differs else ""
    notes = [*notes, *([about] if about else [])]

    def report_of(*, written: bool, backup: str | None) -> "ActionSpaceReport":
        return action_space_change.ActionSpaceReport(
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

    backup = None
    written = shown = False
    if write and change is not None and differs:
        if not force and (change.before is not None or about):
            if shown := not terminal.as_json:  # with what is said about the model
                terminal.emit(None, show_actions(report_of(written=False, backup=None)))
            what = "has other actions" if change.before is not None else "does not exist yet"
            why = "" if shown else f"{about} "
            prompts.agree(f"{path} {what}. {why.lstrip()}Replace them?", yes=False)
        written = action_space_change.write_change(change)
        backup = str(change.backup) if written and change.backup is not None else None

    report = report_of(written=written, backup=backup)
    if shown:
        kept = f"; the old ones are in {backup}" if backup else ""
        terminal.say(f"{path} has these actions now{kept}.")
    else:
        terminal.emit(report, show_actions(report))
    if differs and not written:
        terminal.say("Nothing was written: add --write to put them into model_metadata.json.")


def _drawn(
    out: Path,
    space: "ActionSpace",
    actions: Sequence["ChosenAction"],
    path: Path,
    *,
    force: bool,
) -> str:
    refuse_replacing(out, force=force)
    shares = [action.share for action in actions if action.share is not None]
    rewrite(out, draw_actions(space, shares, f"Actions for {path.name}"))
    return str(out)


def _own_file() -> Path:
    if not (working_folder() / "run.env").is_file():
        return working_folder() / "custom_files" / "model_metadata.json"
    return settings().custom_files_dir / "model_metadata.json"


def _about_the_model(new: "ActionSpace") -> str:
    if not (working_folder() / "run.env").is_file():
        return ""
    loaded = settings()
    try:
        bucket = connect.open_running_bucket(loaded.storage)
        if bucket is None:
            return ""
        checkpoints, trained = action_space_change.trained_with(loaded, bucket)
    except DrError as error:
        return f"Whether {loaded.model_prefix} has checkpoints could not be looked up: {error}"
    model = f"s3://{bucket.name}/{loaded.model_prefix}"
    return action_space_change.sentence_about(model, checkpoints, trained, new)


def _driven(paths: list[Path] | None, prefix: str | None) -> list["DrivenFile"]:

    if paths:
        files = traces_in_folders(paths)
    else:
        loaded = settings()
        bucket = transfer_buckets.bucket_to_look_at(loaded.transfer, upload=False)
        files = traces_of_model(ModelStore(bucket, prefix or loaded.model_prefix))
    skipped = sum(file.skipped for file in files)
    if skipped:
        terminal.warn(f"{skipped:,} lines of {_named(files)} could not be read and were skipped.")
    return files


def _named(files: Sequence["DrivenFile"]) -> str:
    more = f" and {len(files) - 1:,} more" if len(files) > 1 else ""
    return f"{files[0].name}{more}"
