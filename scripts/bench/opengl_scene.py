"""The world that our camera computes, as a MuJoCo model that OpenGL draws: the judge's copy.

Set MUJOCO_GL before anything imports mujoco: `choose_opengl` does that.
"""

import os
import subprocess
import sys
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Cuboids
from drsim.car.car import FRONT, CameraModel
from drsim.sensing.scene import Scene
from drsim.track.appearance import AMBIENT, LUMA, SUN

Floats = NDArray[np.float64]
Frames = NDArray[np.uint8]

_MOST_TEXELS_A_SIDE = 8192
"""What OpenGL libraries take at least; of larger ground pictures a smaller copy is drawn."""

_WALL_HALF_M = 0.01

_PANEL_HALF_M = 0.0002

_TO_SUN = np.array([0.5, -0.1, 0.9]) / np.linalg.norm([0.5, -0.1, 0.9])
"""Direction to the sun. Source: the reference simulator's worlds, 121 of which share one sun."""


def choose_opengl() -> str:
    """Start this program once more with MUJOCO_GL set to what works, unless it is set already.

    MuJoCo reads the variable once, when drsim imports it: too late for a running process.

    Returns:
        The backend in use: "egl", "osmesa", "glfw", or "disable" where no OpenGL works.
    """
    if "MUJOCO_GL" not in os.environ:
        os.environ["MUJOCO_GL"] = _working_opengl() or "disable"
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    if os.environ["MUJOCO_GL"] == "disable":
        print("No OpenGL works here (EGL, OSMesa): mujoco.Renderer is left out.", file=sys.stderr)
    return os.environ["MUJOCO_GL"]


def _working_opengl() -> str | None:
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


class OpenGLCamera:
    """Draws a scene with `mujoco.Renderer`."""

    def __init__(
        self,
        scene: Scene,
        *,
        columns: int = FRONT.columns,
        rows: int = FRONT.rows,
        boxes: Cuboids | None = None,
    ) -> None:
        """Load the scene into OpenGL.

        Args:
            scene: The scene.
            columns: Width of a frame in pixels.
            rows: Height of a frame in pixels.
            boxes: Cuboids, of the type `drsim.race.solids.CUBOID`. Shape (m,).
        """
        model = _model(scene, CameraModel(columns=columns, rows=rows), boxes)
        self._data = mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self._renderer = mujoco.Renderer(model, rows, columns)
        self._luma = np.array(LUMA, np.float32)

    def draw(self, lens_pos: Floats, lens_mat: Floats) -> NDArray[np.float32]:
        """One frame in grey, 0..255.

        Args:
            lens_pos: Lens position in the world, metres. Shape (3,).
            lens_mat: Lens axes in the world: columns forward, left, up. Shape (3, 3).

        Returns:
            Greys, not rounded. Shape (rows, columns).
        """
        self._data.cam_xpos[0] = lens_pos
        axes = np.stack([-lens_mat[:, 1], lens_mat[:, 2], -lens_mat[:, 0]], axis=1)
        self._data.cam_xmat[0] = axes.ravel()
        self._renderer.update_scene(self._data, camera=0)
        grey: NDArray[np.float32] = self._renderer.render() @ self._luma
        return grey

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


def shrunk(picture: NDArray[np.float32], columns: int, rows: int) -> Frames:
    """A picture in fewer pixels, as the reference simulator's filter makes observations.

    Each pixel is an average weighted by a tent two new pixels wide (what Pillow calls bilinear);
    fractions are cut off.
    """
    small = _tents(picture.shape[0], rows) @ picture @ _tents(picture.shape[1], columns).T
    return np.floor(small + 1e-3).astype(np.uint8)


def _tents(many: int, few: int) -> Floats:
    """Weights that shrink a line of pixels. Shape (few, many)."""
    scale = many / few
    away = (np.arange(many) + 0.5) / scale - np.arange(few)[:, None] - 0.5
    weights = np.maximum(1.0 - np.abs(away), 0.0)
    return weights / weights.sum(axis=1, keepdims=True)


def _model(scene: Scene, camera: CameraModel, boxes: Cuboids | None) -> Any:
    """Textured floor, four walls, sky and boxes, lit evenly: greys come out as they go in."""
    level = next(
        index
        for index, (_, _, columns, rows) in enumerate(scene.levels)
        if max(columns, rows) <= _MOST_TEXELS_A_SIDE
    )
    ground = scene.level(level)[::-1]
    rows, columns = ground.shape
    texel_m = scene.texel_m * 2**level
    picture = (
        scene.x_m,
        scene.x_m + columns * texel_m,
        scene.y_m,
        scene.y_m + rows * texel_m,
    )
    geoms = [
        _floor(picture, 'material="ground"'),
        *_walls(scene),
        *_field_around(picture, scene, float(ground[0].mean())),
        *_boxes(boxes),
    ]
    sky = _rgb(scene.sky_grey)
    fovy_deg = np.degrees(2.0 * np.arctan(0.5 * camera.rows / camera.focal_px))
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
            {"".join(geoms)}
            <camera fovy="{fovy_deg}"/>
          </worldbody>
        </mujoco>""")
    model.tex_data[model.tex_adr[0] :][: 3 * ground.size] = np.repeat(ground.ravel(), 3)
    return model


def _floor(area_m: tuple[float, float, float, float], paint: str) -> str:
    low_x, high_x, low_y, high_y = area_m
    return (
        f'<geom type="plane" pos="{0.5 * (low_x + high_x)} {0.5 * (low_y + high_y)} 0"'
        f' size="{0.5 * (high_x - low_x)} {0.5 * (high_y - low_y)} 1" {paint}/>'
    )


def _walls(scene: Scene) -> list[str]:
    """Thin boxes whose inner faces are the walls of the scene."""
    if scene.wall_height_m <= 0.0:
        return []
    low_x, high_x, low_y, high_y = (float(side) for side in scene.walls_m)
    x, y, half_z = 0.5 * (low_x + high_x), 0.5 * (low_y + high_y), 0.5 * scene.wall_height_m
    half_x, half_y = 0.5 * (high_x - low_x), 0.5 * (high_y - low_y)
    places = [
        (low_x - _WALL_HALF_M, y, _WALL_HALF_M, half_y),
        (high_x + _WALL_HALF_M, y, _WALL_HALF_M, half_y),
        (x, low_y - _WALL_HALF_M, half_x, _WALL_HALF_M),
        (x, high_y + _WALL_HALF_M, half_x, _WALL_HALF_M),
    ]
    return [
        f'<geom type="box" pos="{at_x} {at_y} {half_z}" size="{size_x} {size_y} {half_z}"'
        f' rgba="{_rgb(grey)} 1"/>'
        for (at_x, at_y, size_x, size_y), grey in zip(places, scene.wall_greys, strict=True)
    ]


def _field_around(
    picture: tuple[float, float, float, float], scene: Scene, grey: float
) -> list[str]:
    """The field between the painted picture and the end of the world, where there is any."""
    low_x, high_x, low_y, high_y = (float(side) for side in scene.walls_m)
    inner_low_x, inner_high_x, inner_low_y, inner_high_y = picture
    strips = [
        (low_x, inner_low_x, low_y, high_y),
        (inner_high_x, high_x, low_y, high_y),
        (inner_low_x, inner_high_x, low_y, inner_low_y),
        (inner_low_x, inner_high_x, inner_high_y, high_y),
    ]
    paint = f'rgba="{_rgb(grey)} 1"'
    return [
        _floor(strip, paint)
        for strip in strips
        if strip[1] - strip[0] > 0.05 and strip[3] - strip[2] > 0.05
    ]


def _boxes(boxes: Cuboids | None) -> list[str]:
    """Five thin panels for each cuboid, in the greys that its sides have in the light."""
    panels = []
    for x, y, cos, sin, half_x, half_y, low, high, rgb in [] if boxes is None else boxes.tolist():
        grey = float(np.dot(rgb, LUMA))
        half_z = 0.5 * (high - low)
        for forward, left, up in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1)):
            normal = (cos * forward - sin * left, sin * forward + cos * left, up)
            lit = min(grey * (AMBIENT + SUN * max(float(np.dot(normal, _TO_SUN)), 0.0)), 255.0)
            out_x, out_y = (half_x - _PANEL_HALF_M) * forward, (half_y - _PANEL_HALF_M) * left
            at_x, at_y = x + cos * out_x - sin * out_y, y + sin * out_x + cos * out_y
            at_z = high - _PANEL_HALF_M if up else 0.5 * (low + high) - _PANEL_HALF_M
            size_x = _PANEL_HALF_M if forward else half_x
            size_y = _PANEL_HALF_M if left else half_y
            size_z = _PANEL_HALF_M if up else half_z - _PANEL_HALF_M
            panels.append(
                f'<geom type="box" pos="{at_x} {at_y} {at_z}" size="{size_x} {size_y} {size_z}"'
                f' euler="0 0 {np.degrees(np.arctan2(sin, cos))}" rgba="{_rgb(lit)} 1"/>'
            )
    return panels


def _rgb(grey: float) -> str:
    return " ".join(3 * [f"{grey / 255.0:.5f}"])
