"""Accuracy and speed of the computed camera, compared with MuJoCo's renderer.

    python scripts/bench camera [--world NAME] [--tracks-dir DIR] [--tracks 10] [--poses 200]
                                   [--rounds 15] [--json]

Accuracy: random poses on several tracks (community routes if there is a folder of them, here or
next to the checkout, else our own), without and with boxes on the road. OpenGL draws 640 x 480
pixels, shrunk to 160 x 120 as the reference simulator does; the differences are in greys, 0..255.
Speed: both cameras draw 160 x 120 frames of one world, in turns, on the same core.
With --json the last line of stdout is one object with

    tracks, poses          how many of them were compared
    mean_difference        mean absolute difference over all poses
    worst_difference       that of the worst pose, and worst_pose, which one it is
    boxes_mean_difference, boxes_worst_difference   the same with boxes in sight
    correlation            how alike the two pictures are, mean over the poses
    computed_fps           frames/s of the computed camera, the best round
    opengl_fps             frames/s of `mujoco.Renderer`, grey included
    opengl                 the backend it found, for instance "egl"; null where no OpenGL works
    ratio                  median over the rounds of computed over OpenGL, and its range
    build_s                time to build the scene
    scene_mb               memory of the scene

Without a working OpenGL (EGL or OSMesa are tried, unless MUJOCO_GL names one) the figures that need
it are null.
"""

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from machine import print_json
from numpy.typing import NDArray
from opengl_scene import OpenGLCamera, choose_opengl, shrunk

from drsim.arrays import Cuboids
from drsim.car.car import FRONT
from drsim.race.solids import SHAPES, Solids
from drsim.sensing.scene import Scene, build_scene, lens_pose, render
from drsim.track.track import Track
from drsim.track.worlds import known_worlds, load_track

Floats = NDArray[np.float64]
Frames = NDArray[np.uint8]

NUM_FRAMES = 64
"""Frames a round of the race."""

ROUTES = Path(__file__).resolve().parents[3] / "shared" / "tracks"
"""Folder next to the checkout that may hold community routes."""

BOXES_EVERY_M = 1.2
"""Distance between the boxes that are in the way of the judge's lenses."""

OVERSAMPLING = 4
"""OpenGL pixels over ours, each way. Source: the reference simulator's 640 x 480."""


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--world", default="reinvent_base", help="world of the race")
    parser.add_argument("--tracks-dir", type=Path, help="folder with community routes")
    parser.add_argument("--tracks", type=int, default=10, help="how many tracks to compare on")
    parser.add_argument("--poses", type=int, default=200, help="how many poses on all of them")
    parser.add_argument("--rounds", type=int, default=15, help="how often to race")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()

    opengl = choose_opengl() != "disable"
    stay_on_one_core()
    routes = arguments.tracks_dir or (ROUTES if ROUTES.is_dir() else None)
    track = load_track(arguments.world, routes)
    build_scene(track)  # compiles
    started = time.perf_counter()
    scene = build_scene(track)
    build_s = time.perf_counter() - started
    result: dict[str, Any] = {}
    if arguments.poses:
        tracks = some_tracks(arguments.tracks, routes)
        result |= judge(tracks, arguments.poses, opengl=opengl)
    result |= race(scene, *poses_along(track), arguments.rounds, opengl=opengl)
    result["build_s"] = round(build_s, 3)
    result["scene_mb"] = round(scene.texels.nbytes / 2e6, 1)  # words overlap by half
    for name, value in result.items():
        print(f"{name:24} {value}", file=sys.stderr)
    if arguments.json:
        print_json(result)


def stay_on_one_core() -> None:
    """Keep this process and all threads of OpenGL on one core, where the system can do that."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def some_tracks(count: int, routes: Path | None) -> list[Track]:
    """Tracks drawn from our own and those in a folder, always the same ones."""
    names = known_worlds(routes)
    random = np.random.default_rng(0)
    chosen = random.choice(names, min(count, len(names)), replace=False)
    return [load_track(str(name), routes) for name in sorted(chosen)]


def judge(tracks: list[Track], poses: int, *, opengl: bool) -> dict[str, Any]:
    """Compare the pictures of both cameras at random poses, without boxes and with them."""
    random = np.random.default_rng(1)
    each = max(poses // len(tracks), 1)
    differences, with_boxes, alike, names = [], [], [], []
    for track in tracks if opengl else []:
        scene = build_scene(track)
        lenses = random_lenses(track, each, random)
        ours, theirs = both(scene, *lenses, None)
        differences += _differences(ours, theirs)
        alike += [
            np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in zip(ours, theirs, strict=True)
        ]
        names += [f"{track.name} {index}" for index in range(each)]
        boxes = boxes_along(track, lenses[0], random)
        with_boxes += _differences(*both(scene, *lenses, boxes))
    result: dict[str, Any] = {"tracks": len(tracks), "poses": each * len(tracks)}
    keys = ("mean_difference", "worst_difference", "worst_pose", "correlation")
    result |= dict.fromkeys((*keys, "boxes_mean_difference", "boxes_worst_difference"))
    if differences:
        result["mean_difference"] = round(statistics.mean(differences), 3)
        result["worst_difference"] = round(max(differences), 3)
        result["worst_pose"] = names[int(np.argmax(differences))]
        result["correlation"] = round(float(np.mean(alike)), 4)
        result["boxes_mean_difference"] = round(statistics.mean(with_boxes), 3)
        result["boxes_worst_difference"] = round(max(with_boxes), 3)
    return result


def random_lenses(track: Track, count: int, random: np.random.Generator) -> tuple[Floats, Floats]:
    """Lenses of cars anywhere on the road, askew, and tilted as in bends and when braking."""
    x, y, yaw = track.pose_at(random.uniform(0.0, track.length_m, count)).T
    aside_m = random.uniform(-0.4, 0.4, count)
    x, y = x - aside_m * np.sin(yaw), y + aside_m * np.cos(yaw)
    yaw = yaw + random.normal(0.0, 0.5, count)
    pitch = np.radians(random.normal(-1.39, 0.5, count))
    roll = random.normal(0.0, 0.01, count)
    return _lenses(x, y, yaw, pitch, roll)


def boxes_along(track: Track, lens_pos: Floats, random: np.random.Generator) -> Cuboids:
    """Boxes all along the road, but none where a lens is. Shape (1, m)."""
    count = int(track.length_m / BOXES_EVERY_M)
    x, y, yaw = track.pose_at((np.arange(count) + 0.5) * BOXES_EVERY_M).T
    aside_m = random.uniform(-0.4, 0.4, count)
    xy = np.stack([x - aside_m * np.sin(yaw), y + aside_m * np.cos(yaw)], axis=1)
    yaw = yaw + random.normal(0.0, 0.3, count)
    gap_m = np.hypot(*(xy[:, None] - lens_pos[:, :2]).transpose(2, 0, 1)).min(axis=1)
    xy, yaw = xy[gap_m > 0.4], yaw[gap_m > 0.4]
    solids = Solids(1, [SHAPES["box_obstacle"]] * len(xy))
    solids.move(np.array([0]), xy[None], yaw[None])
    return solids.boxes


def both(
    scene: Scene, lens_pos: Floats, lens_mat: Floats, boxes: Cuboids | None
) -> tuple[Frames, Frames]:
    """What the computed camera and OpenGL see. Two arrays of shape (n, 120, 160)."""
    count = len(lens_pos)
    ours = np.zeros((count, FRONT.rows, FRONT.columns), np.uint8)
    theirs = np.zeros_like(ours)
    for_all = None if boxes is None else boxes.repeat(count, axis=0)
    render(scene, lens_pos, lens_mat, ours, boxes=for_all)
    camera = OpenGLCamera(
        scene,
        columns=OVERSAMPLING * FRONT.columns,
        rows=OVERSAMPLING * FRONT.rows,
        boxes=None if boxes is None else boxes[0],
    )
    for index in range(count):
        drawn = camera.draw(lens_pos[index], lens_mat[index])
        theirs[index] = shrunk(drawn, FRONT.columns, FRONT.rows)
    camera.close()
    return ours, theirs


def _differences(ours: Frames, theirs: Frames) -> list[float]:
    """Mean absolute difference of each pair of frames."""
    return [float(value) for value in np.abs(ours.astype(int) - theirs).mean(axis=(1, 2))]


def poses_along(track: Track) -> tuple[Floats, Floats]:
    """Lenses of cars that stand along the track, a little askew and rolled as in bends."""
    random = np.random.default_rng(0)
    x, y, yaw = track.pose_at(np.linspace(0.0, track.length_m, NUM_FRAMES, endpoint=False)).T
    yaw = yaw + random.normal(0.0, 0.2, NUM_FRAMES)
    pitch, roll = np.full(NUM_FRAMES, np.radians(-1.39)), random.normal(0.0, 0.01, NUM_FRAMES)
    return _lenses(x, y, yaw, pitch, roll)


def _lenses(
    x: Floats, y: Floats, yaw: Floats, pitch: Floats, roll: Floats
) -> tuple[Floats, Floats]:
    body_pos = np.stack([x, y, np.full(len(x), -0.001)], axis=1)
    return lens_pose(body_pos, axes_of(yaw, pitch, roll))


def race(
    scene: Scene, lens_pos: Floats, lens_mat: Floats, rounds: int, *, opengl: bool
) -> dict[str, Any]:
    """Time both cameras in turns."""
    ours = np.zeros((NUM_FRAMES, FRONT.rows, FRONT.columns), np.uint8)
    theirs = np.zeros_like(ours)
    camera = OpenGLCamera(scene) if opengl else None

    def draw_ours() -> None:
        render(scene, lens_pos, lens_mat, ours)

    def draw_theirs(camera: OpenGLCamera) -> None:
        for index in range(NUM_FRAMES):
            theirs[index] = camera.draw(lens_pos[index], lens_mat[index])

    draw_ours()  # compiles
    our_fps, their_fps = [], []
    for _ in range(rounds):
        our_fps.append(NUM_FRAMES / _seconds(draw_ours))
        if camera:
            their_fps.append(NUM_FRAMES / _seconds(lambda: draw_theirs(camera)))
    result: dict[str, Any] = {"computed_fps": round(max(our_fps)), "opengl_fps": None}
    result |= {"opengl": None, "ratio": None}
    if camera:
        ratios = sorted(a / b for a, b in zip(our_fps, their_fps, strict=True))
        result["opengl_fps"] = round(max(their_fps))
        result["opengl"] = os.environ["MUJOCO_GL"]
        result["ratio"] = [
            round(value, 1) for value in (statistics.median(ratios), ratios[0], ratios[-1])
        ]
        camera.close()
    return result


def axes_of(yaw: Floats, down: Floats, roll: Floats) -> Floats:
    """Axes in the world, columns forward, left, up, from angles in radians. Shape (n, 3, 3)."""
    return _turns(yaw, 2) @ _turns(down, 1) @ _turns(roll, 0)


def _turns(angle_rad: Floats, axis: int) -> Floats:
    """Rotations about one axis. Shape (n, 3, 3)."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    mat = np.zeros((len(angle_rad), 3, 3))
    mat[:, axis, axis] = 1.0
    mat[:, first, first] = mat[:, second, second] = np.cos(angle_rad)
    mat[:, first, second], mat[:, second, first] = -np.sin(angle_rad), np.sin(angle_rad)
    return mat


def _seconds(work: Callable[[], None]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


if __name__ == "__main__":
    main()
