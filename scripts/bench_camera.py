"""How fast the computed camera is, beside MuJoCo's own renderer drawing the same poses.

    python scripts/bench_camera.py [--world NAME] [--tracks-dir DIR] [--rounds 15] [--json]

Both draw 160 x 120 grey frames on one thread, in turns, from lenses all along the track. With
--json the last line of stdout is one object with

    computed_fps     frames/s of the computed camera, the best round
    opengl_fps       frames/s of `mujoco.Renderer` with the same ground as a texture, grey included
    opengl           the backend it found, for instance "egl"; null where no OpenGL works
    ratio            median over the rounds of computed over OpenGL, and its range
    correlation      how alike the two pictures are, mean over the poses
    build_s          time to build the scene
    scene_mb         memory of the scene

Without a working OpenGL (EGL or OSMesa are tried, unless MUJOCO_GL names one) the figures that need
it are null.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from drsim.camera import FRONT, lens_pose, render
from drsim.look import LUMA
from drsim.scene import Scene, build_scene
from drsim.track import Track
from drsim.worlds import load_track

Floats = NDArray[np.float64]
Frames = NDArray[np.uint8]

NUM_FRAMES = 64


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--world", default="reinvent_base")
    parser.add_argument("--tracks-dir", type=Path, help="folder with community routes")
    parser.add_argument("--rounds", type=int, default=15, help="how often to measure both")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()

    if "MUJOCO_GL" not in os.environ:
        # MuJoCo reads it once, when drsim imports it: too late for this process.
        os.environ["MUJOCO_GL"] = working_opengl() or "disable"
        os.execv(sys.executable, [sys.executable, *sys.argv])
    track = load_track(arguments.world, arguments.tracks_dir)
    build_scene(track)  # compiles
    started = time.perf_counter()
    scene = build_scene(track)
    build_s = time.perf_counter() - started
    result = measure(scene, *poses_along(track), arguments.rounds)
    result["build_s"] = round(build_s, 3)
    result["scene_mb"] = round(scene.texels.nbytes / 2e6, 1)  # words overlap by half
    for name, value in result.items():
        print(f"{name:14} {value}", file=sys.stderr)
    if arguments.json:
        print(json.dumps(result))


def working_opengl() -> str | None:
    """Name of the first OpenGL backend with which MuJoCo can draw without a screen."""
    for backend in ("egl", "osmesa"):
        probe = subprocess.run(
            [sys.executable, "-c", "import mujoco; mujoco.GLContext(16, 16).make_current()"],
            env={**os.environ, "MUJOCO_GL": backend},
            capture_output=True,
            check=False,
        )
        if probe.returncode == 0:
            return backend
    return None


def poses_along(track: Track) -> tuple[Floats, Floats]:
    """Lenses of cars that stand along the track, a little askew and rolled as in bends."""
    random = np.random.default_rng(0)
    x, y, yaw = track.pose_at(np.linspace(0.0, track.length_m, NUM_FRAMES, endpoint=False)).T
    yaw = yaw + random.normal(0.0, 0.2, NUM_FRAMES)
    pitch, roll = np.full(NUM_FRAMES, np.radians(-1.39)), random.normal(0.0, 0.01, NUM_FRAMES)
    body_mat = _turns(yaw, 2) @ _turns(pitch, 1) @ _turns(roll, 0)
    return lens_pose(np.stack([x, y, np.full(NUM_FRAMES, -0.001)], axis=1), body_mat)


def measure(scene: Scene, lens_pos: Floats, lens_mat: Floats, rounds: int) -> dict[str, Any]:
    """Time both cameras in turns and compare their pictures."""
    ours = np.zeros((NUM_FRAMES, FRONT.rows, FRONT.columns), np.uint8)
    theirs = np.zeros_like(ours)
    draw_theirs = opengl_camera(scene, lens_pos, lens_mat, theirs)

    def draw_ours() -> None:
        render(scene, lens_pos, lens_mat, ours)

    draw_ours()  # compiles
    our_fps, their_fps = [], []
    for _ in range(rounds):
        our_fps.append(NUM_FRAMES / _seconds(draw_ours))
        if draw_theirs:
            their_fps.append(NUM_FRAMES / _seconds(draw_theirs))
    result: dict[str, Any] = {"computed_fps": round(max(our_fps)), "opengl_fps": None}
    result |= {"opengl": None, "ratio": None, "correlation": None}
    if draw_theirs:
        ratios = sorted(a / b for a, b in zip(our_fps, their_fps, strict=True))
        alike = [np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in zip(ours, theirs, strict=True)]
        result["opengl_fps"] = round(max(their_fps))
        result["opengl"] = os.environ["MUJOCO_GL"]
        result["ratio"] = [
            round(value, 1) for value in (statistics.median(ratios), ratios[0], ratios[-1])
        ]
        result["correlation"] = round(float(np.mean(alike)), 4)
    return result


def opengl_camera(
    scene: Scene, lens_pos: Floats, lens_mat: Floats, out: Frames
) -> Callable[[], None] | None:
    """A function that draws all poses with `mujoco.Renderer`, or None where no OpenGL works."""
    if os.environ["MUJOCO_GL"] == "disable":
        print("No OpenGL works here (EGL, OSMesa): mujoco.Renderer is left out.", file=sys.stderr)
        return None
    model = opengl_model(scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = mujoco.Renderer(model, FRONT.rows, FRONT.columns)
    luma = np.array(LUMA, np.float32)
    axes = np.stack([-lens_mat[:, :, 1], lens_mat[:, :, 2], -lens_mat[:, :, 0]], axis=2)

    def draw() -> None:
        for index in range(len(out)):
            data.cam_xpos[0] = lens_pos[index]
            data.cam_xmat[0] = axes[index].ravel()
            renderer.update_scene(data, camera=0)
            out[index] = renderer.render() @ luma

    return draw


def opengl_model(scene: Scene) -> Any:
    """The scene as a MuJoCo model: textured floor, four walls, sky; lit evenly."""
    ground = scene.level(1)[::-1]  # full size would go beyond the limits of many OpenGL libraries
    rows, columns = ground.shape
    half_x, half_y = columns * scene.texel_m, rows * scene.texel_m  # a texel of it is twice as wide
    x, y = scene.x_m + half_x, scene.y_m + half_y
    low_x, high_x, low_y, high_y = scene.walls_m
    half_z = 0.5 * scene.wall_height_m
    places = [(low_x, y), (high_x, y), (x, low_y), (x, high_y)]
    sizes = [(0.01, half_y), (0.01, half_y), (half_x, 0.01), (half_x, 0.01)]
    walls = "".join(
        f'<geom type="box" pos="{at[0]} {at[1]} {half_z}" size="{size[0]} {size[1]} {half_z}"'
        f' rgba="{_grey(grey)} 1"/>'
        for at, size, grey in zip(places, sizes, scene.wall_greys, strict=True)
    )
    fovy_deg = np.degrees(2.0 * np.arctan(0.5 * FRONT.rows / FRONT.focal_px))
    sky = _grey(scene.sky_grey)
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <visual>
            <headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/>
            <map znear="0.002"/>
          </visual>
          <asset>
            <texture name="ground" type="2d" builtin="flat" width="{columns}" height="{rows}"/>
            <texture type="skybox" builtin="flat" rgb1="{sky}" rgb2="{sky}" width="8" height="48"/>
            <material name="ground" texture="ground"/>
          </asset>
          <worldbody>
            <geom type="plane" pos="{x} {y} 0" size="{half_x} {half_y} 1" material="ground"/>
            {walls}
            <camera fovy="{fovy_deg}"/>
          </worldbody>
        </mujoco>""")
    model.tex_data[model.tex_adr[0] :][: 3 * ground.size] = np.repeat(ground.ravel(), 3)
    return model


def _grey(grey: float) -> str:
    return " ".join(3 * [f"{grey / 255.0:.4f}"])


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
