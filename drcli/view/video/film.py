"""Makes frames of a film from behind the car, with overlays."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from PIL import Image, ImageDraw

from drcli.view.video.overlay import RGB, Overlay, Readings, Titles
from drcli.view.video.recorded_lap import JUMP_M, RecordedLap, status_label
from drsim.arrays import Bytes, Floats, Ints
from drsim.race.solids import SHAPES, Shape
from drsim.track.track import Track
from drsim.viewing.car_eye import FollowingCamera, lens_above
from drsim.viewing.placed_objects import OPPONENT_COLOR, PlacedObject
from drsim.viewing.world_view import Lens

# A car between the rows of its trace.


_WHEELS_S = 0.158
"""For 63 % of a turn. Source: the reference simulator."""

_LEAN_RAD = 0.012
"""For each m/s2 to the side, for the eye."""


@dataclass(frozen=True, eq=False)
class CarMotion:
    """Where a car is at each of f frames; arrays of shape (f,).

    Attributes:
        poses: Shape (f, 3).
        row: Of the trace, at or before the frame.
        share: Of the way to the next row, 0 to 1.
    """

    poses: Floats
    row: Ints
    share: Floats
    rolled_m: Floats
    wheels_deg: Floats
    roll_rad: Floats


def motion_of(lap: RecordedLap, at_s: Floats) -> CarMotion:
    last = len(lap.time_s) - 1
    row = np.clip(np.searchsorted(lap.time_s, at_s + 1e-6, side="right") - 1, 0, last)
    later = np.minimum(row + 1, last)
    step_s = np.maximum(lap.time_s[later] - lap.time_s[row], 1e-9)
    share = np.clip((at_s - lap.time_s[row]) / step_s, 0.0, 1.0)
    change = lap.poses[later] - lap.poses[row]
    # A car that was put elsewhere does not fly there.
    stays = np.hypot(change[:, 0], change[:, 1]) >= JUMP_M
    poses = lap.poses[row] + np.where(stays, 0.0, share)[:, None] * change
    moved = np.hypot(*np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]).T)
    moved = np.where(moved < JUMP_M, moved, 0.0)
    frame_s = float(at_s[1] - at_s[0]) if len(at_s) > 1 else 1.0
    wheels = np.zeros(len(at_s))
    follows = 1.0 - math.exp(-frame_s / _WHEELS_S)
    wanted = np.clip(lap.steering_deg[row], -30.0, 30.0)
    for frame in range(1, len(at_s)):
        wheels[frame] = wheels[frame - 1] + follows * (wanted[frame] - wheels[frame - 1])
    turning = np.gradient(poses[:, 2]) / frame_s if len(at_s) > 1 else np.zeros(1)
    sideways = np.clip(turning * moved / frame_s, -6.0, 6.0)
    if len(sideways) > 4:
        sideways = np.convolve(sideways, np.ones(5) / 5.0, mode="same")
    return CarMotion(poses, row, share, np.cumsum(moved), wheels, _LEAN_RAD * sideways)


# The small map in a video, with the car's trail.


_RGB = tuple[int, int, int]

_ROAD, _EDGE, _START = (62, 68, 80, 235), (205, 210, 218, 255), (255, 255, 255, 255)
_FINE = 3
"""Drawn larger and shrunk, for smooth edges."""

_SPEEDS = ((58, 82, 230), (38, 176, 212), (80, 200, 96), (250, 196, 40), (236, 72, 48))


def speed_color(share: float) -> _RGB:
    place = min(max(share, 0.0), 1.0) * (len(_SPEEDS) - 1)
    first = min(int(place), len(_SPEEDS) - 2)
    part = place - first
    red, green, blue = (
        round(a + part * (b - a)) for a, b in zip(_SPEEDS[first], _SPEEDS[first + 1], strict=True)
    )
    return red, green, blue


class TrackInset:
    def __init__(self, track: Track, box_px: tuple[int, int]) -> None:
        """`box_px` is the greatest width and height."""
        low_x, low_y, high_x, high_y = track.bounds
        margin = 0.03 * max(high_x - low_x, high_y - low_y) + 0.2
        width_m, height_m = high_x - low_x + 2 * margin, high_y - low_y + 2 * margin
        self._scale = min(box_px[0] / width_m, box_px[1] / height_m)
        self._corner = (low_x - margin, high_y + margin)
        self.size = (max(1, round(width_m * self._scale)), max(1, round(height_m * self._scale)))
        fine = Image.new("RGBA", (self.size[0] * _FINE, self.size[1] * _FINE), (0, 0, 0, 0))
        draw = ImageDraw.Draw(fine)
        rings = [track.outer, track.inner]
        if track.closed:
            # The inner ring is cut out of the outer one, whichever encloses the other.
            areas = [abs(_area(ring)) for ring in rings]
            outer, inner = (rings[0], rings[1]) if areas[0] >= areas[1] else (rings[1], rings[0])
            draw.polygon(self._fine(outer), fill=_ROAD)
            draw.polygon(self._fine(inner), fill=(0, 0, 0, 0))
        else:
            draw.polygon(self._fine(np.concatenate([rings[0], rings[1][::-1]])), fill=_ROAD)
        for ring in rings:
            draw.line(self._fine(ring), fill=_EDGE, width=_FINE)
        draw.line(
            self._fine(np.stack([track.inner[0], track.outer[0]])), fill=_START, width=2 * _FINE
        )
        self._road = fine
        self._base = fine.resize(self.size, Image.Resampling.BOX)
        self._last: tuple[float, float] | None = None

    def wipe(self) -> None:
        self._base = self._road.resize(self.size, Image.Resampling.BOX)
        self._last = None

    def trail(self, xy: tuple[float, float], share: float) -> None:
        """`share` is of the film's fastest speed."""
        here = self._at(xy)
        if self._last is not None and math.dist(here, self._last) < 0.25 * max(self.size):
            draw = ImageDraw.Draw(self._base)
            draw.line([self._last, here], fill=(*speed_color(share), 255), width=2)
        self._last = here

    def picture(
        self,
        marks: Sequence[tuple[tuple[float, float], _RGB, float]],
    ) -> Image.Image:
        """RGBA; `marks` are places, colours and radii in pixels."""
        picture = self._base.copy()
        draw = ImageDraw.Draw(picture)
        for xy, color, radius in marks:
            x, y = self._at(xy)
            box = (x - radius, y - radius, x + radius, y + radius)
            draw.ellipse(
                box, fill=(*color, 255), outline=(255, 255, 255, 255) if radius > 3 else None
            )
        return picture

    def _at(self, xy: tuple[float, float]) -> tuple[float, float]:
        left, top = self._corner
        return (xy[0] - left) * self._scale, (top - xy[1]) * self._scale

    def _fine(self, line: Floats) -> list[tuple[float, float]]:
        return [(_FINE * x, _FINE * y) for x, y in (self._at((a, b)) for a, b in line.tolist())]


def _area(ring: Floats) -> float:
    x, y = (ring - ring[0]).T
    return float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


View = Literal["film", "chase", "top"]

SIZES: dict[str, tuple[int, int]] = {"640x480": (480, 640), "1280x720": (720, 1280)}
GHOST_COLORS: tuple[RGB, ...] = ((70, 205, 255), (190, 120, 255), (120, 235, 120), (255, 210, 90))

_WIDE_FIELD_OF_VIEW_RAD, _FIELD_OF_VIEW_RAD = 1.32, 1.13

_STATUS_S = 1.4
_QUIET = ("", "in_progress", "prepare", "pause", "manual_pause", "park")


class Renderer(Protocol):
    size: tuple[int, int]

    def frame(self, lens: Lens, things: Sequence[PlacedObject]) -> Bytes:
        """Shape (rows, columns, 3)."""

    def close(self) -> None:
        """Free what it holds."""


@dataclass(frozen=True, eq=False)
class Insight:
    """What a policy made of t rows; None where missing.

    Attributes:
        probabilities: Discrete. Shape (t, n).
        asked: Degrees and m/s. Shape (t, 2).
        low: Above 16 % of a training's draws. Shape (t, 2).
        high: Above 84 %.
        value: Of the critic. Shape (t,).
    """

    probabilities: Floats | None
    asked: Floats
    low: Floats | None
    high: Floats | None
    value: Floats | None


@dataclass(frozen=True, eq=False)
class Scene:
    """An episode to film.

    Attributes:
        color: Of the car, 0 to 255.
        camera: What the car saw: grey or RGB. Shape (t, 120, 160) or (t, 120, 160, 3).
    """

    lap: RecordedLap
    titles: Titles
    color: tuple[float, float, float]
    shapes: tuple[Shape, ...] = ()
    camera: Bytes | None = None
    insight: Insight | None = None
    ghosts: tuple[tuple[RecordedLap, RGB], ...] = ()
    other_color: tuple[float, float, float] = OPPONENT_COLOR


class Film:
    def __init__(self, track: Track, renderer: Renderer, fps: int = 15) -> None:
        self._track = track
        self._renderer = renderer
        self._fps = fps
        rows, columns = renderer.size
        wide = columns * 3 > rows * 4
        self._camera = FollowingCamera(
            field_of_view_rad=_WIDE_FIELD_OF_VIEW_RAD if wide else _FIELD_OF_VIEW_RAD
        )
        self._above = lens_above(track, renderer.size)

    def frames(self, scene: Scene, views: Sequence[View] = ("film",)) -> Iterator[list[Bytes]]:
        """One list for each time, of a frame per view: `film` has overlays on `chase`."""
        lap = scene.lap
        at_s = np.minimum(np.arange(frame_count(lap, self._fps)) / self._fps, lap.duration_s)
        motion = motion_of(lap, at_s)
        ghosts = [(motion_of(other, at_s), other, color) for other, color in scene.ghosts]
        overlay = Overlay(self._renderer.size, scene.titles)
        inset = TrackInset(self._track, (overlay.px(150), overlay.px(112)))
        speeds, resets, rewards = lap.driven_mps, lap.resets, np.cumsum(lap.reward)
        fastest = max(float(np.quantile(speeds, 0.99)), float(lap.speed_mps.max()), 0.1)
        events = _events(lap)
        self._camera.cut()
        for number, now_s in enumerate(at_s.tolist()):
            row = int(motion.row[number])
            pose = _pose(motion.poses[number])
            things = self._things(scene, motion, ghosts, number, now_s)
            made: dict[View, Bytes] = {}
            if "top" in views:
                made["top"] = self._renderer.frame(self._above, things)
            if "top" not in views or len(views) > 1:
                lens = self._camera.lens(pose, step_s=1.0 / self._fps)
                made["chase"] = self._renderer.frame(lens, things)
            if "film" not in views:
                yield [made[view] for view in views]
                continue
            frame = made["chase"].copy() if "chase" in views else made["chase"]
            inset.trail((pose[0], pose[1]), float(speeds[row]) / fastest)
            marks = [
                ((float(x), float(y)), (235, 235, 235), overlay.px(2))
                for x, y, _ in lap.objects[row].tolist()
            ]
            marks += [
                ((_pose(other.poses[number])[:2]), color, overlay.px(3))
                for other, _, color in ghosts
            ]
            red, green, blue = (round(c) for c in scene.color)
            marks.append(((pose[0], pose[1]), (red, green, blue), overlay.px(4)))
            status, good = _status(lap, events, row, now_s)
            readings = Readings(
                time_s=now_s,
                speed_mps=float(speeds[row]),
                steering_deg=float(lap.steering_deg[row]),
                progress=float(lap.progress[row]),
                reward=float(rewards[row]),
                step_reward=float(lap.reward[row]),
                resets=int(resets[row]),
                status=status,
                good=good,
                camera=None if scene.camera is None else scene.camera[row],
                fastest_mps=fastest,
                **_choice(scene, row),
            )
            made["film"] = overlay.draw(frame, readings, inset.picture(marks))
            yield [made[view] for view in views]

    def _things(
        self,
        scene: Scene,
        motion: CarMotion,
        ghosts: Sequence[tuple[CarMotion, RecordedLap, RGB]],
        number: int,
        now_s: float,
    ) -> list[PlacedObject]:
        car = SHAPES["race_car"]
        things = [
            PlacedObject(
                car,
                _pose(motion.poses[number]),
                scene.color,
                math.radians(float(motion.wheels_deg[number])),
                float(motion.rolled_m[number]),
                float(motion.roll_rad[number]),
            )
        ]
        row = int(motion.row[number])
        later = min(row + 1, len(scene.lap.time_s) - 1)
        here, there = scene.lap.objects[row], scene.lap.objects[later]
        for shape, pose, following in zip(scene.shapes, here, there, strict=False):
            if np.hypot(*(following - pose)[:2]) < JUMP_M:
                turn = (following[2] - pose[2] + math.pi) % (2.0 * math.pi) - math.pi
                pose = pose + motion.share[number] * np.array([*(following - pose)[:2], turn])
            paint = scene.other_color if shape.name == "race_car" else None
            things.append(PlacedObject(shape, _pose(pose), paint))
        for other, lap, color in ghosts:
            if now_s <= lap.duration_s + 1e-6:
                wheels = math.radians(float(other.wheels_deg[number]))
                rolled = float(other.rolled_m[number])
                things.append(
                    PlacedObject(car, _pose(other.poses[number]), color, wheels, rolled, ghost=True)
                )
        return things


def frame_count(lap: RecordedLap, fps: int) -> int:
    """Beginning and last row included."""
    return 1 + math.ceil(lap.duration_s * fps - 1e-6)


def _pose(values: Floats) -> tuple[float, float, float]:
    x, y, yaw = values.tolist()
    return x, y, yaw


def _events(lap: RecordedLap) -> list[tuple[float, str]]:
    return [
        (float(time_s), status)
        for time_s, status, before in zip(lap.time_s, lap.status, (None, *lap.status), strict=False)
        if status not in (before, *_QUIET)
    ]


def _status(
    lap: RecordedLap, events: Sequence[tuple[float, str]], row: int, now_s: float
) -> tuple[str, bool]:
    if lap.status[row] == "pause":
        return "Penalty", False
    ahead_s = 1.0 if events and events[-1][0] >= lap.duration_s - 1e-6 else 0.0
    for since_s, status in reversed(events):
        # What ends an episode is shown a little before, or nobody could read it.
        early = ahead_s if since_s >= lap.duration_s - 1e-6 else 0.0
        if since_s - 0.25 * early <= now_s <= since_s + _STATUS_S:
            if status == "lap_complete":
                return lap.end, lap.clean
            return status_label(status), False
    return "", False


def _choice(scene: Scene, row: int) -> dict[str, Any]:
    """Fields of `Readings`."""
    insight, lap = scene.insight, scene.lap
    if insight is None:
        asked = (float(lap.steering_deg[row]), float(lap.speed_mps[row]))
        return {"probabilities": None, "asked": asked, "spread": None, "value": None}
    spread = None
    if insight.low is not None and insight.high is not None:
        spread = (insight.low[row].tolist(), insight.high[row].tolist())
    return {
        "probabilities": None if insight.probabilities is None else insight.probabilities[row],
        "asked": insight.asked[row].tolist(),
        "spread": spread,
        "value": None if insight.value is None else float(insight.value[row]),
    }
