"""Camera frames of many cars, rendered on other threads in the background."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np

from drsim.arrays import Bytes, Floats, Ints
from drsim.car.camera_mount import EYES_APART_M, FRONT
from drsim.race.solids import Solids
from drsim.sensing.camera import render
from drsim.sensing.lamps import Lamps
from drsim.sensing.lighting import Lighting
from drsim.sensing.scene import Scene

_FRAMES_PER_JOB = 4
"""Small enough to share the work evenly; starting a job costs about half a frame."""

_FRAMES_ALONE = 2
"""So few frames are rendered before another thread would wake up."""


class FrameRenderer:
    """The current frame of every car.

    Attributes:
        frames: Grey frames, rewritten between `start` and `finish`; with two eyes the left one
            first. Shape (n, eyes, 120, 160).
    """

    def __init__(
        self,
        scene: Scene,
        num_cars: int,
        num_threads: int,
        *,
        eyes: int = 1,
        solids: Solids | None = None,
        lighting: Lighting | None = None,
        lamps: Lamps | None = None,
        after: Callable[[slice], None] | None = None,
    ) -> None:
        """Prepare black frames for one or two eyes; `num_threads` render, the caller's included.

        `solids` must not move between `start` and `finish`. `after` is called with the rows of
        frames that have just been rendered, on the thread that rendered them.
        """
        self.frames: Bytes = np.zeros((num_cars, eyes, FRONT.rows, FRONT.columns), np.uint8)
        self._scene = scene
        self._solids = solids
        self._lighting = lighting
        self._lamps = lamps
        self._after = after
        self._num_threads = num_threads
        self._pool = _pool(num_threads)
        self._jobs: list[tuple[slice, Floats, Floats]] = []
        self._futures: list[Future[None]] = []

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the threads."""
        return {**self.__dict__, "_pool": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Start new threads for a copy."""
        self.__dict__.update(state)
        self._pool = _pool(self._num_threads)

    def start(self, cars: Ints, lens_pos: Floats, lens_mat: Floats) -> None:
        """Begin to render the frames of some cars, in rising order, with the lenses of all."""
        # Copied, because the caller may move the cars while other threads render.
        lens_pos, lens_mat = lens_pos.copy(), lens_mat.copy()
        for first, last in _runs(cars):
            for begin in range(first, last, _FRAMES_PER_JOB):
                rows = slice(begin, min(begin + _FRAMES_PER_JOB, last))
                self._jobs.append((rows, lens_pos[rows], lens_mat[rows]))
        if self._pool is not None and len(cars) > _FRAMES_ALONE:
            self._futures = [self._pool.submit(self._render, *job) for job in self._jobs]

    def finish(self) -> None:
        """Render what no other thread has begun, and wait for the rest."""
        if not self._futures:
            for job in self._jobs:
                self._render(*job)
        else:
            # From the end, because the other threads work from the beginning.
            for future, job in zip(reversed(self._futures), reversed(self._jobs), strict=True):
                if future.cancel():
                    self._render(*job)
            for future in self._futures:
                if not future.cancelled():
                    future.result()
        self._jobs = []
        self._futures = []

    def close(self) -> None:
        """Stop the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def _render(self, rows: slice, lens_pos: Floats, lens_mat: Floats) -> None:
        boxes = None if self._solids is None else self._solids.boxes[rows]
        light = None if self._lighting is None else self._lighting.of(rows)
        eyes = self.frames.shape[1]
        lamps = self._lamps
        if lamps is not None and not lamps.lit(rows):
            lamps = None
        for eye in range(eyes):
            to_left_m = (0.5 * (eyes - 1) - eye) * EYES_APART_M
            render(
                self._scene,
                lens_pos + to_left_m * lens_mat[:, :, 1],
                lens_mat,
                self.frames[rows, eye],
                boxes=boxes,
                light=light,
                rounding=eyes > 1,
                on_ground=None if lamps is None else partial(lamps.reflect, rows),
                over_all=None if lamps is None else partial(lamps.shine, rows),
            )
        if self._after is not None:
            self._after(rows)


def _pool(num_threads: int) -> ThreadPoolExecutor | None:
    """Threads beside the caller's own; they begin with the first job."""
    return ThreadPoolExecutor(num_threads - 1) if num_threads > 1 else None


def _runs(cars: Ints) -> list[tuple[int, int]]:
    """First and last (exclusive) of each row of neighbouring cars."""
    if not len(cars):
        return []
    if cars[-1] - cars[0] + 1 == len(cars):
        return [(int(cars[0]), int(cars[-1]) + 1)]
    ends = np.flatnonzero(np.diff(cars) != 1)
    firsts, lasts = [cars[0], *cars[ends + 1]], [*cars[ends], cars[-1]]
    return [(int(first), int(last) + 1) for first, last in zip(firsts, lasts, strict=True)]
