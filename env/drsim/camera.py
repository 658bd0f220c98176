"""The computed camera: where a car's lens is and what it sees of a scene, as grey frames.

No OpenGL is involved: `drsim.raycast` follows each pixel's ray to the ground, a wall or the sky.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drsim import raycast
from drsim.scene import Scene

Floats = NDArray[np.float64]
Frames = NDArray[np.uint8]


@dataclass(frozen=True)
class CameraModel:
    """Numbers of a front camera. Source of the defaults: the reference simulator's car model.

    Attributes:
        mount_m: Lens in the car's base frame: forward, left, up.
        pitch_rad: Tilt of the lens relative to the chassis, nose down positive. The car rests
            1.39 degrees nose up, so a resting lens looks 13.6 degrees down.
        field_of_view_rad: Horizontal opening angle.
        columns: Width of a frame in pixels.
        rows: Height of a frame in pixels; pixels are square, the optical axis is in the middle.
    """

    mount_m: tuple[float, float, float] = (0.145294, 0.0, 0.130326)
    pitch_rad: float = 0.2618
    field_of_view_rad: float = 1.13
    columns: int = 160
    rows: int = 120

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.columns / math.tan(0.5 * self.field_of_view_rad)


FRONT = CameraModel()
"""The one camera of a car without stereo."""


def lens_pose(
    body_pos: Floats, body_mat: Floats, camera: CameraModel = FRONT
) -> tuple[Floats, Floats]:
    """Where the lenses of cars are and where they look.

    Args:
        body_pos: Car origins (base frame) in the world, metres. Shape (n, 3).
        body_mat: Car axes in the world: columns forward, left, up. Shape (n, 3, 3).
        camera: The camera's numbers.

    Returns:
        Lens positions, metres, shape (n, 3), and lens axes in the world, columns forward, left,
        up, shape (n, 3, 3).
    """
    cos, sin = math.cos(camera.pitch_rad), math.sin(camera.pitch_rad)
    tilt = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    return body_pos + body_mat @ np.array(camera.mount_m), body_mat @ tilt


def render(
    scene: Scene, lens_pos: Floats, lens_mat: Floats, out: Frames, camera: CameraModel = FRONT
) -> None:
    """Draw what lenses see, one frame each.

    Runs without the GIL and writes nothing but `out`, so that threads may each draw a slice. A lens
    outside the walls misses the ones it has passed; a pose that is not finite gives a black frame.

    Args:
        scene: The world around.
        lens_pos: Lens positions in the world, metres. Shape (n, 3).
        lens_mat: Lens axes in the world: columns forward, left, up. Shape (n, 3, 3).
        out: Frames to write. Shape (n, rows, columns).
        camera: The camera's numbers.

    Raises:
        ValueError: When the shapes do not fit together.
    """
    cars = len(lens_pos)
    shapes = lens_pos.shape, lens_mat.shape, out.shape
    if shapes != ((cars, 3), (cars, 3, 3), (cars, camera.rows, camera.columns)):
        raise ValueError(
            f"{shapes} are no shapes of n positions, n axes and n frames of "
            f"{camera.rows} x {camera.columns} pixels."
        )
    raycast.draw(
        scene.texels,
        scene.levels,
        np.array([scene.x_m, scene.y_m, scene.texel_m]),
        scene.walls_m,
        scene.wall_height_m,
        scene.wall_greys,
        scene.sky_grey,
        camera.focal_px,
        lens_pos,
        lens_mat,
        out,
    )
