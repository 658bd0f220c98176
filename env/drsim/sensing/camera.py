"""The computed camera: grey frames of what lenses see, without OpenGL.

`raycast` draws ground, walls and sky, then `cuboids` what stands there.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Cuboids, Floats, Ints, Singles
from drsim.car.camera_mount import FRONT, CameraModel
from drsim.sensing import cuboids, raycast
from drsim.sensing.scene import Scene
from drsim.track.appearance import AMBIENT, LUMA, SUN

Frames = NDArray[np.uint8]
LensParts = tuple[Floats, Floats, float, float]


def lens_pose(
    body_pos: Floats, body_mat: Floats, camera: CameraModel = FRONT
) -> tuple[Floats, Floats]:
    """Of lenses, given those of base frames."""
    cos, sin = math.cos(camera.pitch_rad), math.sin(camera.pitch_rad)
    tilt = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    return body_pos + body_mat @ np.array(camera.mount_m), body_mat @ tilt


class Light(NamedTuple):
    """What the light makes of a scene, for each lens: greys, and light on solids per colour.

    Attributes:
        palettes: Of the greys of the ground. Shape (n, 256).
        sun: On sides that face it. Shape (n, 3).
    """

    palettes: Frames
    wall_greys: Singles
    sky_greys: Singles
    ambient: Singles
    sun: Singles


def render(
    scene: Scene,
    lens_pos: Floats,
    lens_mat: Floats,
    out: Frames,
    camera: CameraModel = FRONT,
    *,
    boxes: Cuboids | None = None,
    light: Light | None = None,
    rounding: bool = False,
) -> None:
    """Draw what lenses see, one frame each, without the GIL.

    A lens outside the walls misses the ones it has passed; a pose that is not finite gives a black
    frame. `lens_pos` is in metres, `lens_mat` has columns forward, left, up, and `boxes` the type
    `solids.CUBOID`, shape (n, m). `rounding` is for the reference's stereo frames.

    Raises:
        ValueError: The shapes do not fit together.
    """
    cars = len(lens_pos)
    shapes = lens_pos.shape, lens_mat.shape, out.shape
    if shapes != ((cars, 3), (cars, 3, 3), (cars, camera.rows, camera.columns)):
        raise ValueError(
            f"The shapes {shapes} do not fit n positions, n axes and n frames of "
            f"{camera.rows} x {camera.columns} pixels."
        )
    if boxes is not None and len(boxes) != cars:
        raise ValueError(f"There are boxes for {len(boxes)} lenses, but {cars} lenses.")
    if light is not None and len(light.palettes) != cars:
        raise ValueError(f"There is light for {len(light.palettes)} lenses, but {cars} lenses.")
    lenses = lens_parts(lens_pos, lens_mat, camera, rounding=rounding)
    draw_ground(scene, lenses, out, np.arange(cars), np.zeros(1, np.int64), light)
    if boxes is not None:
        draw_solids(boxes, lenses, out, light)


def lens_parts(
    lens_pos: Floats, lens_mat: Floats, camera: CameraModel = FRONT, *, rounding: bool = False
) -> LensParts:
    return lens_pos, lens_mat, camera.focal_px, 0.5 if rounding else _WHOLE


def draw_ground(
    scene: Scene, lenses: LensParts, out: Frames, wanted: Ints, taken: Ints, light: Light | None
) -> None:
    """Threads that share the counter `taken`, an array of one 0, share the work."""
    backdrop = scene.backdrop
    if light is not None:
        greys = light.wall_greys, light.sky_greys, light.palettes
        backdrop = scene.walls_m, scene.wall_height_m, *greys
    raycast.draw(scene.picture, backdrop, lenses, out, wanted, taken)


def draw_solids(boxes: Cuboids, lenses: LensParts, out: Frames, light: Light | None) -> None:
    cuboids.draw(boxes, _on_solids(light, len(boxes)), lenses, out)


_WHOLE = 1e-3
"""The reference's filter cuts fractions off; a thousandth keeps whole greys whole."""


def _on_solids(light: Light | None, cars: int) -> Singles:
    if light is None:
        usual = [weight * part for part in (AMBIENT, SUN) for weight in LUMA]
        return np.tile(np.array(usual, np.float32), (cars, 1))
    luma = np.array(LUMA, np.float32)
    return np.concatenate([light.ambient * luma, light.sun * luma], axis=1)
