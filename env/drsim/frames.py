"""Camera frames of many cars, rendered on other threads while the caller goes on."""

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from drsim.camera import FRONT, render
from drsim.scene import Scene

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_FRAMES_PER_JOB = 4
"""Small enough to share work evenly; handing over a job costs about half a frame."""


class FrameRenderer:
    """The current frame of every car.

    Attributes:
        frames: Grey frames, rewritten between `start` and `finish`. Shape (n, 120, 160).
    """

    def __init__(self, scene: Scene, num_cars: int, num_threads: int) -> None:
        """Prepare empty frames.

        Args:
            scene: What the cameras see.
            num_cars: How many cars.
            num_threads: Threads that render, the caller's included.
        """
        self.frames: NDArray[np.uint8] = np.zeros((num_cars, FRONT.rows, FRONT.columns), np.uint8)
        self._scene = scene
        self._pool = ThreadPoolExecutor(num_threads - 1) if num_threads > 1 else None
        self._jobs: list[tuple[slice, Floats, Floats]] = []
        self._futures: list[Future[None]] = []

    def start(self, cars: Ints, lens_pos: Floats, lens_mat: Floats) -> None:
        """Begin to render the frames of some cars.

        Args:
            cars: Which cars, in rising order. Shape (k,).
            lens_pos: Lenses of all cars, metres; copied. Shape (n, 3).
            lens_mat: Their axes in the world; copied. Shape (n, 3, 3).
        """
        runs = np.split(cars, np.flatnonzero(np.diff(cars) != 1) + 1)
        for run in runs:
            for first in range(0, len(run), _FRAMES_PER_JOB):
                part = run[first : first + _FRAMES_PER_JOB]
                rows = slice(int(part[0]), int(part[-1]) + 1)
                self._jobs.append((rows, lens_pos[rows].copy(), lens_mat[rows].copy()))
        if self._pool is not None:
            self._futures = [self._pool.submit(self._render, *job) for job in self._jobs]

    def finish(self) -> None:
        """Render what no other thread has begun, and wait for the rest."""
        if self._pool is None:
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
        render(self._scene, lens_pos, lens_mat, self.frames[rows])
