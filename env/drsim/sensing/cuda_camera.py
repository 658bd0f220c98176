"""Draws ground, walls and sky of camera frames on an NVIDIA GPU. Importing it loads CUDA."""

from collections.abc import Sequence
from typing import Any

import numba.cuda
import numpy as np

from drsim.arrays import Bytes, Ints, Singles
from drsim.car.camera_mount import FRONT, CameraModel
from drsim.sensing import cuda_raycast
from drsim.sensing.camera import LensParts, Light
from drsim.sensing.scene import Scene

cuda: Any = numba.cuda  # numba sets its names at run time

_POSE = 13


class CudaCamera:
    """Draws what the lenses of n cars see, and keeps the frames on the GPU.

    A step makes three calls of the driver, because each takes as long as several frames.

    Attributes:
        frames: In main memory, complete after `wait`. Shape (n, eyes, rows, columns).
        device_frames: With the interface of CUDA arrays.
    """

    def __init__(
        self, scene: Scene, num_cars: int, *, eyes: int = 1, camera: CameraModel = FRONT
    ) -> None:
        """Copy the scene to the GPU, 18 to 55 MB.

        Raises:
            OSError: There is no GPU that can be used.
        """
        self._eyes = eyes
        shape = (num_cars, eyes, camera.rows, camera.columns)
        walls = *scene.walls_m.tolist(), scene.wall_height_m
        self._world = tuple(map(float, (scene.x_m, scene.y_m, scene.texel_m, *walls)))
        shades = np.append(scene.wall_greys, np.float32(scene.sky_grey))[None]
        same = np.arange(256, dtype=np.uint8)[None]
        try:
            self._stream = cuda.stream()
            self.frames: Bytes = cuda.pinned_array(shape, np.uint8)
            self.frames[:] = 0
            self.device_frames: Any = cuda.to_device(self.frames)
            self._out = self.device_frames.reshape(num_cars * eyes, *shape[2:])
            self._pairs = cuda.to_device(scene.pairs())
            self._levels = cuda.to_device(scene.levels)
            self._lenses = cuda.pinned_array((num_cars * eyes, _POSE), np.float64)
            self._lenses[:] = 0.0
            self._device_lenses = cuda.to_device(self._lenses)
            self._usual = cuda.to_device(shades), cuda.to_device(same)
            self._light: tuple[Singles, Bytes] | None = None
            self._device_light = self._usual
            self._draw(1, self._usual, (camera.focal_px, 0.0))  # compiles the kernel
            self.send()
        except Exception as error:  # CUDA's and the compiler's errors have no other common base
            raise OSError(" ".join(f"{type(error).__name__}: {error}".split())) from error

    def draw(self, eyes: Sequence[LensParts], cars: Ints, light: Light | None) -> None:
        if not len(cars):
            return
        count = len(cars)
        for eye, (pos, mat, _, _) in enumerate(eyes):
            rows = self._lenses[eye * count : (eye + 1) * count]
            rows[:, :3] = pos[cars]
            rows[:, 3:12] = mat[cars].reshape(count, 9)
            rows[:, 12] = cars * self._eyes + eye
        self._device_lenses.copy_to_device(self._lenses, stream=self._stream)
        shade = self._usual if light is None else self._of(light)
        self._draw(count * len(eyes), shade, eyes[0][2:])

    def _draw(self, count: int, shade: tuple[Any, Any], lens: tuple[float, float]) -> None:
        height, width = self.frames.shape[2:]
        grid = (-(-height // cuda_raycast.ROWS), count)
        cuda_raycast.draw[grid, max(width, 32), self._stream](
            self._pairs,
            self._levels,
            self._world,
            *shade,
            self._device_lenses,
            lens,
            self._eyes,
            self._out,
        )

    def fetch(self) -> None:
        self.device_frames.copy_to_host(self.frames, stream=self._stream)

    def wait(self) -> None:
        self._stream.synchronize()

    def send(self) -> None:
        """Copy all frames to the GPU after something was drawn over them."""
        self.device_frames.copy_to_device(self.frames, stream=self._stream)
        self._stream.synchronize()

    def _of(self, light: Light) -> tuple[Any, Any]:
        shades = np.column_stack([light.wall_greys, light.sky_greys])
        known = self._light
        if (
            known is None
            or not np.array_equal(known[0], shades)
            or not np.array_equal(known[1], light.palettes)
        ):
            self._light = shades, light.palettes.copy()
            self._device_light = cuda.to_device(shades), cuda.to_device(light.palettes)
        return self._device_light
