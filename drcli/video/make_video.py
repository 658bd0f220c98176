"""Makes a video of a trace: chooses the episodes, films them, and writes the files."""

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from drcli.base.errors import NotAvailable, SettingsError
from drcli.base.replaceable import refuse_replacing
from drcli.config.shell_colors import shell_color
from drcli.exchange.laps import counted_resets
from drcli.exchange.trace import STATUS_LABELS
from drcli.video import encode
from drcli.video.film import GHOST_COLORS, SIZES, Film, Renderer, Scene, View, frame_count
from drcli.video.overlay import Titles, clock
from drcli.video.recorded_lap import RecordedLap
from drcli.video.trace_source import FoundTrace
from drcli.video.video_report import FilmedEpisode, VideoReport
from drsim.race.solids import SHAPES, Shape
from drsim.track.track import Track
from drsim.viewing.camera_paths import lens_above
from drsim.viewing.car_eye import CarEye
from drsim.viewing.placed_things import OPPONENT_COLOR
from drsim.viewing.world_view import WorldView

if TYPE_CHECKING:
    from drcli.saliency.policy_outputs import ExplainedPolicy

RendererName = Literal["raycast", "mujoco"]

ENDINGS = (".mp4", ".gif")

USUAL_SECONDS = 300
"""Where a film that somebody waits for ends: a lap with many resets can take much longer."""


@dataclass(frozen=True)
class Wish:
    """How a video should be.

    Attributes:
        episode: "best", "all", or the number of an episode as the trace counts.
        size: A key of `SIZES`.
        fps: Frames per second; poses between two steps are worked out.
        ghosts: So many other laps of the same trace drive along, the fastest ones.
        renderer: What makes the view from behind.
        color: As DR_CAR_COLOR.
        racer: The racer's name.
        explain: Lay over the camera which pixels moved the action.
        most_seconds: Where the film ends, however long the episodes are; None for no limit.
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

    @property
    def most_frames(self) -> float:
        """As many as the film may have."""
        return math.inf if self.most_seconds is None else self.most_seconds * self.fps


def film_trace(
    trace: FoundTrace,
    track: Track,
    wish: Wish,
    files: Sequence[tuple[View, Path]],
    *,
    subject: "ExplainedPolicy | None" = None,
    driver: str = "",
    others: Sequence[tuple[str, RecordedLap]] = (),
) -> VideoReport:
    """Film a trace, once for each view, into one file each.

    Args:
        trace: What to film.
        track: What it was driven on.
        wish: How the film should be.
        files: The views, and where they go; the ending says whether it is a video or a GIF.
        subject: The policy whose probabilities are shown; None for none.
        driver: What the titles call what drove, such as `model · checkpoint 3`.
        others: Further laps that drive along as ghosts, and their names.

    Raises:
        NotAvailable: A library for the film is missing.
        SettingsError: The trace does not have that episode, or a file cannot be written.
    """
    laps = chosen_laps(trace.laps, wish.episode, trace.origin)
    for _, path in files:
        if path.suffix.lower() == ".mp4":
            encode.require_encoder()
    shapes = _shapes(trace)
    rows, columns = SIZES[wish.size]
    renderer = _renderer(wish, track, (rows, columns))
    film = Film(track, renderer, wish.fps)
    eye = CarEye(track, shapes)
    total = 0
    filmed: list[FilmedEpisode] = []

    def scenes() -> Iterator[Scene]:
        for lap in laps:
            filmed.append(_filmed(lap))
            ghosts = _ghosts(trace, lap, wish.ghosts, others)
            yield _scene(trace, track, lap, wish, eye, shapes, subject, driver, ghosts)

    try:
        with contextlib.ExitStack() as stack:
            writers = [
                stack.enter_context(
                    encode.gif(path, wish.fps)
                    if path.suffix.lower() == ".gif"
                    else encode.mp4(path, (rows, columns), wish.fps)
                )
                for _, path in files
            ]
            views = [view for view, _ in files]
            for frames in (made for scene in scenes() for made in film.frames(scene, views)):
                for writer, frame in zip(writers, frames, strict=True):
                    writer.add(frame)
                total += 1
                if total >= wish.most_frames or all(writer.full for writer in writers):
                    break
    finally:
        renderer.close()
    form = encode.form_of(files[0][1], encode.Form(columns, rows, wish.fps, total))
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
        renderer=wish.renderer,
        episodes=filmed,
        notes=[*trace.notes, *_cut(laps, wish)],
    )


def frames_of(trace: FoundTrace, wish: Wish) -> int:
    """How many frames the film will have."""
    laps = chosen_laps(trace.laps, wish.episode, trace.origin)
    return int(min(_frames(laps, wish), wish.most_frames))


def _frames(laps: Sequence[RecordedLap], wish: Wish) -> int:
    return sum(frame_count(lap, wish.fps) for lap in laps)


def _cut(laps: Sequence[RecordedLap], wish: Wish) -> list[str]:
    """A sentence if the film ends before the episodes do."""
    frames = _frames(laps, wish)
    if frames <= wish.most_frames:
        return []
    what = "the episode takes" if len(laps) == 1 else "the episodes take"
    return [
        f"The film ends after {wish.most_seconds} s; {what} {math.ceil(frames / wish.fps)} s "
        "(`dr-video --seconds` moves the end)."
    ]


def chosen_laps(laps: Sequence[RecordedLap], episode: str, origin: str) -> list[RecordedLap]:
    """The episodes that are asked for.

    Raises:
        SettingsError: There is no such episode.
    """
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
    """Refuse a name that is not a video's, to replace a file, and a place that takes none.

    Raises:
        SettingsError: It is one of these.
    """
    if path.suffix.lower() not in ENDINGS:
        raise SettingsError(
            f"{path} ends neither in .mp4 nor in .gif.",
            remedy="Name another file with --out, such as --out lap.mp4 or --out lap.gif.",
        )
    refuse_replacing(path, force=force)


def rank_of(lap: RecordedLap) -> tuple[bool, int, float]:
    """Sorts completed laps first, those without a reset before others, the fastest first."""
    if lap.completed:
        return False, int(lap.resets[-1]), lap.duration_s
    return True, 0, -float(lap.progress[-1])


def _renderer(wish: Wish, track: Track, size: tuple[int, int]) -> Renderer:
    if wish.renderer == "mujoco":
        from drsim.viewing.mujoco_view import MujocoView, RendererError

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
    """The shapes of the recorded objects; none where the laps have none."""
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
    """The laps that drive along: those that were named, then the best ones of the same trace."""
    rest = sorted((other for other in trace.laps if other is not lap), key=rank_of)[:count]
    named = [*others, *((f"episode {other.number}", other) for other in rest)]
    return [(f"{name}  {_ghost_time(other)}", other) for name, other in named[: len(GHOST_COLORS)]]


def _ghost_time(lap: RecordedLap) -> str:
    """The time of a ghost with its resets, in as little room as a title has."""
    resets = int(lap.resets[-1])
    return f"{clock(lap.duration_s)}, {counted_resets(resets)}" if resets else clock(lap.duration_s)


def _scene(
    trace: FoundTrace,
    track: Track,
    lap: RecordedLap,
    wish: Wish,
    eye: CarEye,
    shapes: tuple[Shape, ...],
    subject: "ExplainedPolicy | None",
    driver: str,
    ghosts: Sequence[tuple[str, RecordedLap]],
) -> Scene:
    """An episode with everything that the film shows of it."""
    insight = None
    actions: tuple[tuple[float, float], ...] = ()
    if subject is None:
        camera = eye.frames(lap.poses, lap.objects)[:, 0]
    else:
        from drcli.video.policy_insight import look_through  # torch takes seconds to load

        seen = look_through(subject, eye, lap, explain=wish.explain)
        insight, camera, actions = seen.insight, seen.camera, seen.actions
    other_color = "" if trace.recording is None else trace.recording.other_color
    where = f"{track.name} · episode {lap.number}"
    titles = Titles(
        wish.racer or "DeepRacer",
        driver or trace.origin,
        where,
        actions,
        tuple((name, color) for (name, _), color in zip(ghosts, GHOST_COLORS, strict=False)),
    )
    return Scene(
        lap,
        titles,
        shell_color(wish.color),
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
