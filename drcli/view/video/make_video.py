"""Films the chosen episodes of a trace."""

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from drcli.base.clock import duration
from drcli.base.errors import NotAvailable, SettingsError
from drcli.base.files import refuse_replacing
from drcli.base.installation import lazy_imports
from drcli.base.report import Col, bold, table
from drcli.base.report import View as Shown
from drcli.config.value_types import shell_color
from drcli.records.iteration import counted_resets
from drcli.records.trace import STATUS_LABELS
from drcli.view.video import encode
from drcli.view.video.film import (
    GHOST_COLORS,
    SIZES,
    Film,
    Insight,
    Renderer,
    Scene,
    View,
    frame_count,
)
from drcli.view.video.overlay import Titles, clock
from drcli.view.video.recorded_lap import RecordedLap
from drcli.view.video.trace_source import FoundTrace
from drsim.arrays import Bytes
from drsim.race.solids import SHAPES, Shape
from drsim.track.track import Track
from drsim.viewing.car_eye import CarEye, lens_above
from drsim.viewing.mujoco_view import MujocoView, RendererError
from drsim.viewing.placed_objects import OPPONENT_COLOR
from drsim.viewing.world_view import WorldView

if TYPE_CHECKING:
    from drcli.view.saliency.policy_outputs import ExplainedPolicy

with lazy_imports():
    from drcli.view.video import policy_insight

# What a video holds.


@dataclass(frozen=True)
class FilmedEpisode:
    """An episode in a video."""

    episode: Annotated[int, "Its number in the trace.", Col("episode")]
    seconds: Annotated[float, "Simulated seconds.", Col("time", "{:.2f} s")]
    progress: Annotated[float, "Percent of the lap.", Col("progress", "{:.1f} %")]
    status: Annotated[str, 'How it ended, such as "Lap complete".']
    resets: Annotated[int, "How often the car left the track or crashed before its end."]
    penalty_s: Annotated[float, "In the time, simulated seconds."] = 0.0
    clean: Annotated[bool, "Completed without reset and penalty."] = False
    text: Annotated[str, "End, and time of a completed lap, for people.", Col("ended")] = ""


@dataclass(frozen=True)
class VideoReport:
    """What `dr-video` made."""

    file: Annotated[str, "The video."]
    seconds: Annotated[float, "How long it plays."]
    frames: Annotated[int, "How many."]
    width: Annotated[int, "Pixels."]
    height: Annotated[int, "Pixels."]
    fps: Annotated[int, "Frames per second."]
    world: Annotated[str, "The track."]
    trace: Annotated[str, "What was filmed."]
    model: Annotated[str, "Prefix of the model that drove, or empty."]
    checkpoint: Annotated[str, "Whose probabilities are shown, or empty."]
    renderer: Annotated[str, "What made the view."]
    episodes: Annotated[list[FilmedEpisode], "In the order of the film."]
    notes: Annotated[list[str], "What a reader should know."] = field(default_factory=list)

    def view(self) -> Shown:
        size = f"{self.width}x{self.height}, {self.fps} frames per second"
        return [
            bold(f"{self.trace} on {self.world}"),
            table(self.episodes),
            (f"Video of {self.seconds:.2f} s, {size}: ", bold(self.file)),
        ]


RendererName = Literal["raycast", "mujoco"]

ENDINGS = (".mp4", ".gif")

USUAL_SECONDS = 300
STUCK_SECONDS = 10

_TIMED_FRAMES = 15
_LONG_S = 15.0


@dataclass(frozen=True)
class VideoOptions:
    """How a video should be.

    Attributes:
        episode: "best", "all", or a number in the trace.
        size: A key of `SIZES`.
        ghosts: The fastest other laps of the trace.
        color: As DR_CAR_COLOR.
        explain: Show which pixels moved the action.
        most_seconds: None for no limit.
        stuck_seconds: Film no longer than this after the car last came further; None for no limit.
    """

    episode: str = "best"
    size: str = "640x480"
    fps: int = 15
    ghosts: int = 0
    renderer: RendererName = "raycast"
    color: str = "Red"
    racer: str = ""
    explain: bool = False
    most_seconds: int | None = None
    stuck_seconds: int | None = None

    @property
    def most_frames(self) -> float:
        return math.inf if self.most_seconds is None else self.most_seconds * self.fps


def film_trace(
    trace: FoundTrace,
    track: Track,
    options: VideoOptions,
    files: Sequence[tuple[View, Path]],
    *,
    subject: "ExplainedPolicy | None" = None,
    driver: str = "",
    others: Sequence[tuple[str, RecordedLap]] = (),
    on_progress: Callable[[str], object] = lambda _: None,
) -> VideoReport:
    """Film a trace into a video or GIF for each view.

    `driver` is what titles call the driver, such as `model · checkpoint 3`; `others` become ghosts.
    `on_progress` hears after the first frames how long the others take, if that is long.

    Raises:
        NotAvailable: A library is missing.
        SettingsError: The episode does not exist, or a file cannot be written.
    """
    laps = chosen_laps(trace.laps, options.episode, trace.origin)
    for _, path in files:
        if path.suffix.lower() == ".mp4":
            encode.require_encoder()
    shapes = _shapes(trace)
    rows, columns = SIZES[options.size]
    renderer = _renderer(options, track, (rows, columns))
    film = Film(track, renderer, options.fps)
    eye = CarEye(track, shapes)
    total = 0
    filmed: list[FilmedEpisode] = []
    views, paths = [view for view, _ in files], [path for _, path in files]

    def pictures() -> Iterator[list[Bytes]]:
        for lap in laps:
            filmed.append(_filmed(lap))
            ghosts = _ghosts(trace, lap, options.ghosts, others)
            scene = _scene(trace, track, lap, options, eye, shapes, subject, driver, ghosts)
            yield from islice(film.frames(scene, views), _frames([lap], options))

    try:
        with contextlib.ExitStack() as stack:
            writers = [
                stack.enter_context(
                    encode.gif(path, options.fps)
                    if path.suffix.lower() == ".gif"
                    else encode.mp4(path, (rows, columns), options.fps)
                )
                for _, path in files
            ]
            begun_s = 0.0
            for frames in pictures():
                for writer, frame in zip(writers, frames, strict=True):
                    writer.add(frame)
                total += 1
                if total == 1:  # which compiles what the others use
                    begun_s = time.monotonic()
                elif total == _TIMED_FRAMES:
                    frame_s = (time.monotonic() - begun_s) / (total - 1)
                    rest_s = frame_s * (frames_of(trace, options, paths) - total)
                    if rest_s > _LONG_S:
                        on_progress(f"The film is done in about {duration(rest_s)}.")
                if total >= options.most_frames or all(writer.full for writer in writers):
                    break
    finally:
        renderer.close()
    form = encode.form_of(files[0][1], encode.Form(columns, rows, options.fps, total))
    return VideoReport(
        file=str(files[0][1]),
        seconds=form.frames / form.fps,
        frames=form.frames,
        width=form.columns,
        height=form.rows,
        fps=form.fps,
        world=track.name,
        trace=trace.origin,
        model=trace.model,
        checkpoint=driver if subject is not None else "",
        renderer=options.renderer,
        episodes=filmed,
        notes=[*trace.notes, *_cut(laps, options, paths)],
    )


def frames_of(trace: FoundTrace, options: VideoOptions, paths: Sequence[Path]) -> int:
    """Of the film whose views are written to these files."""
    laps = chosen_laps(trace.laps, options.episode, trace.origin)
    most = min(options.most_frames, encode.most_frames(paths, options.fps))
    return int(min(_frames(laps, options), most))


def plan_of(trace: FoundTrace, options: VideoOptions, paths: Sequence[Path]) -> str:
    """What is filmed and how long it will be, such as "Filming 12.4 s (187 frames) of m ..."."""
    frames = frames_of(trace, options, paths)
    return f"Filming {frames / options.fps:.1f} s ({frames} frames) of {trace.origin} ..."


def _frames(laps: Sequence[RecordedLap], options: VideoOptions) -> int:
    return sum(
        int(min(frame_count(lap, options.fps), _frames_until_stuck(lap, options))) for lap in laps
    )


def _frames_until_stuck(lap: RecordedLap, options: VideoOptions) -> float:
    if options.stuck_seconds is None:
        return math.inf
    return 1 + math.ceil((lap.progressed_s + options.stuck_seconds) * options.fps)


def _cut(laps: Sequence[RecordedLap], options: VideoOptions, paths: Sequence[Path]) -> list[str]:
    notes = []
    for lap in laps:
        stuck_s = lap.duration_s - lap.progressed_s
        if frame_count(lap, options.fps) > _frames_until_stuck(lap, options):
            notes.append(
                f"The car comes no further after {lap.progressed_s:.1f} s of episode {lap.number}; "
                f"the film shows {options.stuck_seconds} s of the {stuck_s:.1f} s after that "
                "(`dr-video --seconds 0` shows all)."
            )
    frames, of_file = _frames(laps, options), encode.most_frames(paths, options.fps)
    what = "the episode takes" if len(laps) == 1 else "the episodes take"
    whole = f"{what} {math.ceil(frames / options.fps)} s"
    if frames > of_file and of_file < options.most_frames:
        most_s = round(of_file / options.fps)
        notes.append(f"A GIF ends after {most_s} s; {whole} (an MP4 shows all of it).")
    elif frames > options.most_frames:
        notes.append(
            f"The film ends after {options.most_seconds} s; {whole} (`dr-video --seconds` moves "
            "the end)."
        )
    return notes


def chosen_laps(laps: Sequence[RecordedLap], episode: str, origin: str) -> list[RecordedLap]:
    """Raises SettingsError without such an episode."""
    if episode == "all":
        return list(laps)
    if episode == "best":
        return [min(laps, key=rank_of)]
    found = [lap for lap in laps if str(lap.number) == episode]
    if not found:
        first, last = laps[0].number, laps[-1].number
        raise SettingsError(
            f"{origin} has no episode {episode:.20}.",
            remedy=f"Choose best, all, or a number from {first} to {last} with --episode.",
        )
    return found[:1]


def refuse_file(path: Path, *, force: bool = False) -> None:
    """Raises SettingsError for names of other files, replacing a file, and bad places."""
    if path.suffix.lower() not in ENDINGS:
        raise SettingsError(
            f"{path} ends neither in .mp4 nor in .gif.",
            remedy="Name another file with --out, such as --out lap.mp4 or --out lap.gif.",
        )
    refuse_replacing(path, force=force)


def rank_of(lap: RecordedLap) -> tuple[bool, int, float]:
    if lap.completed:
        return False, int(lap.resets[-1]), lap.duration_s
    return True, 0, -float(lap.progress[-1])


def _renderer(options: VideoOptions, track: Track, size: tuple[int, int]) -> Renderer:
    if options.renderer == "mujoco":
        try:
            view = MujocoView(track, columns=size[1], rows=size[0])
            view.frame(lens_above(track, size), [])
        except RendererError as error:
            raise NotAvailable(
                f"--renderer mujoco needs OpenGL: {error}",
                remedy="Install OpenGL without a window (Debian: `apt-get install libegl1 "
                "libgl1-mesa-dri`), set MUJOCO_GL=osmesa or egl, or leave out --renderer.",
            ) from None
        return view
    return WorldView(track, columns=size[1], rows=size[0])


def _shapes(trace: FoundTrace) -> tuple[Shape, ...]:
    names = [] if trace.recording is None else trace.recording.shapes
    count = trace.laps[0].objects.shape[1]
    known = tuple(SHAPES[name] for name in names if name in SHAPES)
    return known if len(known) == count == len(names) else ()


def _ghosts(
    trace: FoundTrace,
    lap: RecordedLap,
    count: int,
    others: Sequence[tuple[str, RecordedLap]],
) -> list[tuple[str, RecordedLap]]:
    rest = sorted((other for other in trace.laps if other is not lap), key=rank_of)[:count]
    named = [*others, *((f"episode {other.number}", other) for other in rest)]
    return [(f"{name}  {_ghost_time(other)}", other) for name, other in named[: len(GHOST_COLORS)]]


def _ghost_time(lap: RecordedLap) -> str:
    resets = int(lap.resets[-1])
    return clock(lap.duration_s) + (f", {counted_resets(resets)}" if resets else "")


def _scene(
    trace: FoundTrace,
    track: Track,
    lap: RecordedLap,
    options: VideoOptions,
    eye: CarEye,
    shapes: tuple[Shape, ...],
    subject: "ExplainedPolicy | None",
    driver: str,
    ghosts: Sequence[tuple[str, RecordedLap]],
) -> Scene:
    seen: tuple[Insight | None, Bytes, tuple[tuple[float, float], ...]]
    if subject is None:
        seen = None, eye.frames(lap.poses, lap.objects)[:, 0], ()
    else:
        seen = policy_insight.look_through(subject, eye, lap, explain=options.explain)
    insight, camera, actions = seen
    other_color = "" if trace.recording is None else trace.recording.other_color
    where = f"{track.name} · episode {lap.number}"
    titles = Titles(
        options.racer or "DeepRacer",
        driver or trace.origin,
        where,
        actions,
        tuple((name, color) for (name, _), color in zip(ghosts, GHOST_COLORS, strict=False)),
    )
    return Scene(
        lap,
        titles,
        shell_color(options.color),
        shapes,
        camera,
        insight,
        tuple((other, color) for (_, other), color in zip(ghosts, GHOST_COLORS, strict=False)),
        shell_color(other_color) if other_color else OPPONENT_COLOR,
    )


def _filmed(lap: RecordedLap) -> FilmedEpisode:
    status = lap.status[-1]
    return FilmedEpisode(
        lap.number,
        round(lap.duration_s, 3),
        round(float(lap.progress[-1]), 3),
        STATUS_LABELS.get(status, status),
        int(lap.resets[-1]),
        round(lap.penalty_s, 3),
        lap.clean,
        lap.told,
    )
