"""Camera frames that are drawn in the memory of an NVIDIA GPU.

Only ground, walls and sky are drawn there, which takes nearly all of the time. Import it only where
a GPU is wanted: it loads CUDA.
"""

from typing import Any

import numba.cuda
import numpy as np

from drsim.arrays import Bytes, Floats, Ints
from drsim.car.camera_mount import FRONT, CameraModel
from drsim.sensing import cuda_raycast
from drsim.sensing.camera import LensParts, Light
from drsim.sensing.scene import Scene

cuda: Any = numba.cuda  # numba sets its names at run time


class CudaCamera:
    """Draws what the lenses of n cars see, and keeps the frames on the GPU.

    Attributes:
        frames: The same frames in main memory, complete after `wait`. Shape (n, eyes, rows,
            columns).
        device_frames: The frames on the GPU, with the interface of CUDA arrays.
    """

    def __init__(
        self, scene: Scene, num_cars: int, *, eyes: int = 1, camera: CameraModel = FRONT
    ) -> None:
        """Copy the scene to the GPU, 18 to 55 MB.

        Raises:
            OSError: There is no GPU that can be used; it says why.
        """
        try:
            self._stream = cuda.stream()
            shape = (num_cars, eyes, camera.rows, camera.columns)
            self.frames: Bytes = cuda.pinned_array(shape, np.uint8)
            self.frames[:] = 0
            self.device_frames: Any = cuda.to_device(self.frames)
            texels = scene.pairs()
            self._ground = (
                cuda.to_device(texels),
                cuda.to_device(scene.levels),
                scene.x_m,
                scene.y_m,
                scene.texel_m,
            )
            same = np.arange(256, dtype=np.uint8)[None]
            self._walls = cuda.to_device(scene.walls_m), scene.wall_height_m
            self._light = self._on_device(
                scene.wall_greys[None], np.array([scene.sky_grey], np.float32), same
            )
        except Exception as error:  # CUDA's errors have no common base but this one
            raise OSError(f"{type(error).__name__}: {error}") from error

    def draw(self, eye: int, lenses: LensParts, cars: Ints, light: Light | None) -> None:
        """Begin to draw the frames of some cars, shape (k,), as `camera.draw_ground` does."""
        if not len(cars):
            return
        pos, mat, focal_px, bias = lenses
        shade = self._light
        if light is not None:
            shade = self._on_device(light.wall_greys, light.sky_greys, light.palettes)
        rows, columns = self.frames.shape[2:]
        grid = (-(-rows // cuda_raycast.ROWS), len(cars))
        kernel: Any = cuda_raycast.draw
        kernel[grid, max(columns, 32), self._stream](
            self._ground,
            (*self._walls, *shade),
            *self._on_device(pos, mat),
            (focal_px, bias),
            *self._on_device(cars),
            self.device_frames[:, eye],
        )

    def fetch(self) -> None:
        """Begin to copy all frames to main memory."""
        self.device_frames.copy_to_host(self.frames, stream=self._stream)

    def wait(self) -> None:
        """Wait until `frames` is complete."""
        self._stream.synchronize()

    def send(self) -> None:
        """Copy all frames to the GPU, because something was drawn over them in main memory."""
        self.device_frames.copy_to_device(self.frames, stream=self._stream)
        self._stream.synchronize()

    def _on_device(self, *arrays: Floats | Any) -> tuple[Any, ...]:
        return tuple(
            cuda.to_device(np.ascontiguousarray(array), stream=self._stream) for array in arrays
        )
