"""Draws ground, walls and sky of camera frames on an NVIDIA GPU. Importing it loads CUDA."""

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numba.cuda
import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Bytes, Ints, LensParts, Single, Singles
from drsim.car.car import FRONT, CameraModel
from drsim.sensing.raycast import (
    EDGE_BLUR,
    FURTHEST,
    LEAST_FALL,
    MOST_LINES,
    Lens,
    nearness,
    ray_through,
    sampling,
)
from drsim.sensing.scene import Light, Scene

# The camera's inner loops on an NVIDIA GPU.
#
# Greys differ from `raycast`'s by one at most, because a GPU multiplies and adds without rounding
# in between.


F = TypeVar("F", bound=Callable[..., Any])

cuda: Any = numba.cuda  # numba sets its names at run time
_numba_config: Any = numba.config
_numba_config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # few cars are few blocks


def _on_gpu(function: F) -> F:
    return cast(F, cuda.jit(device=True)(function))


ROWS = 8
_GAPS = ROWS + 1
_LINES = MOST_LINES * _GAPS
_WALLS = 4
_TASKS = _LINES + ROWS + _WALLS
_SHARPNESS = 1.0 / EDGE_BLUR


def _draw(
    pairs: Any,
    levels: Any,
    world: tuple[float, ...],
    shades: Any,
    palettes: Any,
    lenses: Any,
    lens: tuple[float, float],
    eyes: int,
    out: Any,
) -> None:
    """Draw frames: blocks of a thread for each column, a grid of (strips of rows, frames).

    `world` is x and y of the ground picture's corner, side of a texel, walls and their height,
    metres; `lenses` position, axes row by row, frame, (k, 13); `lens` focal length in pixels and
    what is added to a grey.
    """
    corner_x_m, corner_y_m, finest_m = world[0], world[1], world[2]
    focal_px, bias = lens
    rows, columns = out.shape[1], out.shape[2]
    pose = lenses[cuda.blockIdx.y]
    number = int(pose[12])
    car = number // eyes
    top = ROWS * cuda.blockIdx.x
    thread = cuda.threadIdx.x

    # Of each sample line: its origin, the ray to its first pixel, the change to the next one, and
    # its weights in the rows above and below it.
    line_rays = cuda.shared.array((_LINES, 10), np.float32)
    line_levels = cuda.shared.array(_LINES, np.int32)
    line_counts = cuda.shared.array(_GAPS, np.int32)
    row_rays = cuda.shared.array((ROWS, 6), np.float32)
    near = cuda.shared.array(_WALLS, np.float32)

    x_m, y_m, z_m = pose[0], pose[1], pose[2]
    own = Lens(
        (x_m, y_m, z_m),
        (pose[3], pose[6], pose[9]),
        (pose[4], pose[7], pose[10]),
        (pose[5], pose[8], pose[11]),
        focal_px,
    )
    is_known = math.isfinite(
        x_m + y_m + z_m + sum_of(own.forward) + sum_of(own.left) + sum_of(own.up)
    )
    height_m = min(max(z_m, 1e-3), 10.0)
    for task in range(thread, _TASKS, cuda.blockDim.x):
        if task < _LINES:
            gap, line = task // MOST_LINES, task % MOST_LINES
            aimed = top - 1 + gap
            index, lines = sampling(own, aimed + 1.0, rows, height_m, finest_m, len(levels))
            line_counts[gap] = lines
            line_levels[task] = index
            texel_m = finest_m * (1 << index)
            origin_x = 256.0 * ((x_m - corner_x_m) / texel_m - 0.5)
            origin_y = 256.0 * ((y_m - corner_y_m) / texel_m - 0.5)
            to_texels = Single(-256.0 * height_m / texel_m)
            ahead, step = ray_through(own, aimed + 0.5 + (line + 0.5) / lines, rows, columns)
            line_rays[task, 0] = Single(min(max(origin_x, -FURTHEST), FURTHEST))
            line_rays[task, 1] = Single(min(max(origin_y, -FURTHEST), FURTHEST))
            line_rays[task, 2] = to_texels * Single(ahead[0])
            line_rays[task, 3] = to_texels * Single(ahead[1])
            line_rays[task, 4] = Single(ahead[2])
            line_rays[task, 5] = to_texels * Single(step[0])
            line_rays[task, 6] = to_texels * Single(step[1])
            line_rays[task, 7] = Single(step[2])
            part, weight = (line + 0.5) / lines, 1.0 / (65536.0 * lines)
            line_rays[task, 8] = Single(weight - part * weight)
            line_rays[task, 9] = Single(part * weight)
        elif task < _LINES + ROWS:
            row = task - _LINES
            ahead, step = ray_through(own, top + row + 0.5, rows, columns)
            row_rays[row, 0], row_rays[row, 3] = Single(ahead[0]), Single(step[0])
            row_rays[row, 1], row_rays[row, 4] = Single(ahead[1]), Single(step[1])
            row_rays[row, 2], row_rays[row, 5] = Single(ahead[2]), Single(step[2])
        else:
            wall = task - _LINES - ROWS
            near[wall] = nearness(world[3 + wall] - (x_m if wall < 2 else y_m))
    cuda.syncthreads()

    if thread >= columns:
        return
    if not is_known:
        for row in range(top, min(top + ROWS, rows)):
            out[number, row, thread] = np.uint8(0)
        return
    edges = Single(z_m), Single(z_m - world[7]), Single(focal_px * _SHARPNESS)
    shade = shades[car % shades.shape[0]]
    palette = palettes[car % palettes.shape[0]]
    column = Single(np.int32(thread))
    above = Single(0.0)
    for gap in range(_GAPS):
        row = gap - 1
        here, below = above, Single(0.0)
        for line in range(line_counts[gap]):
            task = MOST_LINES * gap + line
            grey = ground_grey(pairs, levels[line_levels[task]], palette, line_rays[task], column)
            here += line_rays[task, 8] * grey
            below += line_rays[task, 9] * grey
        if gap > 0 and top + row < rows:
            behind, share = backdrop_grey(near, edges, shade, row_rays[row], column)
            out[number, top + row, thread] = np.uint8(
                np.int32(behind + share * (here - behind) + Single(bias))
            )
        above = below


@_on_gpu
def sum_of(vector: tuple[float, float, float]) -> float:
    return vector[0] + vector[1] + vector[2]


@_on_gpu
def ground_grey(
    pairs: Any, level: Any, palette: NDArray[np.uint8], ray: Any, column: Single
) -> Single:
    """In 65536ths."""
    depth = Single(1.0) / min(ray[4] + column * ray[7], Single(-LEAST_FALL))
    last_x, last_y = np.int32(256 * (level[2] - 1)), np.int32(256 * (level[3] - 1))
    x = min(max(np.int32(ray[0] + depth * (ray[2] + column * ray[5])), np.int32(0)), last_x)
    y = min(max(np.int32(ray[1] + depth * (ray[3] + column * ray[6])), np.int32(0)), last_y)
    at = level[0] + (y >> 8) * level[1] + (x >> 8)
    left, right = np.int32(pairs[at]), np.int32(pairs[at + 1])
    across, up = x & 255, y & 255
    left_grey = palette[left & 255] * (256 - up) + palette[left >> 8] * up
    right_grey = palette[right & 255] * (256 - up) + palette[right >> 8] * up
    return Single(np.int32(left_grey * (256 - across) + right_grey * across))


@_on_gpu
def backdrop_grey(
    near: Any,
    edges: tuple[Single, Single, Single],
    shade: Any,
    ray: Any,
    column: Single,
) -> tuple[Single, Single]:
    zero, half, one = Single(0.0), Single(0.5), Single(1.0)
    x, y = ray[0] + column * ray[3], ray[1] + column * ray[4]
    z = ray[2] + column * ray[5]
    near_x = x * (near[1] if x > zero else near[0])
    near_y = y * (near[3] if y > zero else near[2])
    grey_x = shade[1] if x > zero else shade[0]
    grey_y = shade[3] if y > zero else shade[2]
    grey = grey_x if near_x > near_y else grey_y
    nearest = max(near_x, near_y, zero)
    sky = min(max(half + (edges[1] * nearest + z) * edges[2], zero), one)
    share = min(max(half - (edges[0] * nearest + z) * edges[2], zero), one)
    return grey + sky * (shade[4] - grey), share


draw: Any = cuda.jit(_draw)
"""`draw[grid, threads, stream](...)`. Compiling takes seconds."""


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
        grid = (-(-height // ROWS), count)
        draw[grid, max(width, 32), self._stream](
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
