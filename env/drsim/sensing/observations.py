"""Camera frames and lidar scans of many cars, refreshed after every step."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from drsim.arrays import Bytes, Floats, Ints, LensParts, Singles
from drsim.car.car import EYES_APART_M, FRONT, CarBatch
from drsim.car.conditions import Conditions, Disturbances
from drsim.race.solids import CUBOID, Solids
from drsim.race.traffic import Traffic
from drsim.sensing.lighting import Lamps, Lighting
from drsim.sensing.scene import Scene, draw_ground, draw_solids, lens_parts
from drsim.sensing.sensors import LIDAR, Sensors, scan
from drsim.track.appearance import look_of
from drsim.track.ways import Ways

if TYPE_CHECKING:
    from drsim.sensing.cuda_camera import CudaCamera

_FRAMES_PER_JOB = 4
_FRAMES_ALONE = 2
"""Until another thread would wake up."""


class FrameRenderer:
    """The current frame of every car.

    Threads share the work frame by frame without Python, because the caller computes in Python
    meanwhile.

    Attributes:
        frames: Grey, rewritten between `start` and `finish`; left eye first. Shape (n, eyes, 120,
            160).
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        scene_of: Ints,
        num_threads: int,
        *,
        eyes: int = 1,
        solids: Solids | None = None,
        lighting: Lighting | None = None,
        lamps: Sequence[Lamps] = (),
        after: Callable[[slice], None] | None = None,
        changes: Callable[[Ints], bool] | None = None,
        gpu: "CudaCamera | None" = None,
    ) -> None:
        """`num_threads` render, the caller's included; `scene_of` is that of each car.

        `solids` must not move between `start` and `finish`. `after` gets the rows of rendered
        frames, on the thread that finished them.
        """
        shape = (len(scene_of), eyes, FRONT.rows, FRONT.columns)
        self.frames: Bytes = np.zeros(shape, np.uint8) if gpu is None else gpu.frames
        self._gpu = gpu
        self._scenes = scenes
        self._scene_of = scene_of
        self._solids = solids
        self._lighting = lighting
        self._lamps = lamps
        self._after = after
        self._changes = changes
        self._num_threads = num_threads
        self._pool = pool_of(num_threads)
        self._cars: Ints = np.empty(0, np.int64)
        self._eyes: list[tuple[LensParts, Bytes]] = []
        self._parts: list[tuple[Scene, LensParts, Bytes, Ints, Ints]] = []
        self._futures: list[Future[None]] = []

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._pool = pool_of(self._num_threads)

    def start(self, cars: Ints, lens_pos: Floats, lens_mat: Floats) -> None:
        """Begin to render some cars, in rising order."""
        self._cars = cars
        if not len(cars):
            return
        lens_mat = lens_mat.copy()  # the caller may move the cars while other threads render
        eyes = self.frames.shape[1]
        for eye in range(eyes):
            to_left_m = (0.5 * (eyes - 1) - eye) * EYES_APART_M
            lenses = lens_parts(
                lens_pos + to_left_m * lens_mat[:, :, 1], lens_mat, rounding=eyes > 1
            )
            self._eyes.append((lenses, self.frames[:, eye]))
        if self._gpu is not None:
            light = None if self._lighting is None else self._lighting.of(slice(None))
            self._gpu.draw([lenses for lenses, _ in self._eyes], cars, light)
            self._gpu.fetch()
            return
        scenes = self._scene_of[cars]
        self._parts = [
            (self._scenes[k], lenses, frames, cars[scenes == k], np.zeros(1, np.int64))
            for k in np.unique(scenes)
            for lenses, frames in self._eyes
        ]
        if self._pool is not None and len(cars) > _FRAMES_ALONE:
            self._futures = [
                self._pool.submit(self._draw_ground) for _ in range(self._num_threads - 1)
            ]

    def finish(self) -> None:
        try:
            if self._gpu is None:
                self._draw_ground()
                _wait(self._futures)  # ends what has not begun: nothing is left for it
            elif len(self._cars):
                self._gpu.wait()
            after = self._after is not None and (self._changes is None or self._changes(self._cars))
            lit = any(lamps.lit(self._cars) for lamps in self._lamps)
            if len(self._cars) and (self._solids is not None or lit or after):
                jobs = [partial(self._draw_over, rows) for rows in _jobs(self._cars)]
                share_out(self._pool if len(self._cars) > _FRAMES_ALONE else None, jobs)
                if self._gpu is not None:
                    self._gpu.send()
        finally:
            self._cars = np.empty(0, np.int64)
            self._eyes, self._parts = [], []
            self._futures = []

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()

    def _draw_ground(self) -> None:
        light = None if self._lighting is None else self._lighting.of(slice(None))
        for scene, lenses, frames, cars, taken in self._parts:
            draw_ground(scene, lenses, frames, cars, taken, light)

    def _draw_over(self, rows: slice) -> None:
        light = None if self._lighting is None else self._lighting.of(rows)
        lit = [lamps for lamps in self._lamps if lamps.lit(rows)]
        for (pos, mat, focal_px, bias), all_frames in self._eyes:
            lenses, frames = (pos[rows], mat[rows], focal_px, bias), all_frames[rows]
            for lamps in lit:
                lamps.reflect(rows, frames, lenses)
            if self._solids is not None:
                draw_solids(self._solids.boxes[rows], lenses, frames, light)
            for lamps in lit:
                lamps.shine(rows, frames, lenses)
        if self._after is not None:
            self._after(rows)


def pool_of(num_threads: int) -> ThreadPoolExecutor | None:
    """The caller works, too."""
    return ThreadPoolExecutor(num_threads - 1) if num_threads > 1 else None


def share_out(pool: ThreadPoolExecutor | None, jobs: Sequence[Callable[[], None]]) -> None:
    futures = [] if pool is None else [pool.submit(job) for job in jobs]
    try:
        # From the end, because the other threads work from the beginning.
        for number in reversed(range(len(jobs))):
            if pool is None or futures[number].cancel():
                jobs[number]()
    finally:
        _wait(futures)


def _wait(futures: Sequence[Future[None]]) -> None:
    """Cancel what has not begun, and raise what failed."""
    for future in futures:
        if not future.cancel():
            future.result()


def _jobs(cars: Ints) -> list[slice]:
    """A few neighbours each."""
    runs = np.split(cars, np.flatnonzero(np.diff(cars) != 1) + 1)
    return [
        slice(begin, min(begin + _FRAMES_PER_JOB, int(run[-1]) + 1))
        for run in runs
        for begin in range(int(run[0]), int(run[-1]) + 1, _FRAMES_PER_JOB)
    ]


Randomize = Literal["nothing", "lights", "textures"]
"""`lights` are those of the reference's domain randomisation, `textures` also the colours of the
world.
"""


class Observations(FrameRenderer):
    """Camera frames and lidar scans of n cars.

    Attributes:
        frames: Rewritten between `start` and `finish`. Shape (n, eyes, 120, 160).
        scans: Shape (n, d).
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        num_threads: int,
        *,
        ways: Ways,
        sensors: Sensors,
        traffic: Traffic | None,
        disturbances: Disturbances,
        randomize: Randomize,
        gpu: bool = False,
    ) -> None:
        """`num_threads` render, the caller's included, or a GPU if there is one track.

        Raises:
            OSError: There is no GPU that can be used.
        """
        num_cars = len(ways.way)
        self._ways = ways
        self._sensors = sensors
        self._traffic = traffic
        self._disturbances = disturbances
        lighting = None
        if randomize != "nothing":
            looks = [look_of(track.name) for track in ways.tracks[::2]]
            lighting = Lighting(num_cars, looks, textures=randomize == "textures")
        camera = None
        if gpu and len(scenes) > 1:
            raise OSError("a GPU draws one track at a time")
        if gpu:
            try:
                from drsim.sensing.cuda_camera import CudaCamera  # loads CUDA
            except (ImportError, AttributeError) as error:
                raise OSError(f"numba cannot load CUDA: {error}") from error

            camera = CudaCamera(scenes[0], num_cars, eyes=sensors.eyes)
        super().__init__(
            scenes,
            ways.road,
            num_threads,
            eyes=sensors.eyes,
            solids=Solids(num_cars, traffic.shapes) if traffic is not None else None,
            lighting=lighting,
            lamps=[Lamps(scene, num_cars) for scene in scenes],
            after=self._spoil,
            changes=disturbances.spoils,
            gpu=camera,
        )
        nothing = np.full((num_cars, LIDAR.samples), np.inf, np.float32)
        self.scans: Singles = sensors.process(nothing)

    @property
    def device_frames(self) -> Any:
        """With the interface of CUDA arrays; None without a GPU."""
        return None if self._gpu is None else self._gpu.device_frames

    def draw(self, car: int, random: np.random.Generator) -> None:
        if self._lighting is None:
            return
        self._lighting.draw(car, random, int(self._ways.road[car]))
        if self._solids is not None and self._traffic is not None:
            colors = random.uniform(0.0, 255.0, (1, len(self._traffic.shapes), 3))
            self._solids.paint(np.array([car]), colors)

    def light(self, car: int, conditions: Conditions) -> None:
        for k, lamps in enumerate(self._lamps):
            share = float(k == self._ways.road[car])  # the lamps of other halls do not shine here
            lamps.begin(
                car,
                glare=share * conditions.glare,
                reflections=share * conditions.reflections,
                pattern=conditions.pattern,
            )

    def look(self, cars: Ints, bodies: CarBatch) -> None:
        """Begin to draw what these cars perceive; `finish` completes the frames."""
        if self._solids is not None and self._traffic is not None:
            self._solids.move(cars, self._traffic.xy[cars], self._traffic.yaw_rad[cars])
        lens_pos, lens_mat = self._disturbances.lenses(bodies.lens_pos, bodies.lens_mat)
        self._disturbances.next_frames(cars)
        self.start(cars, lens_pos, lens_mat)
        if self._sensors.lidar and len(cars):
            self._scan(cars, bodies)

    def _scan(self, cars: Ints, bodies: CarBatch) -> None:
        scenes = self._scene_of[cars]
        for k in np.unique(scenes):
            mine, scene = cars[scenes == k], self._scenes[k]
            boxes = np.empty((len(mine), 0), CUBOID)
            if self._solids is not None:
                boxes = self._solids.boxes[mine]
            rays = scan(
                scene.walls_m,
                scene.wall_height_m,
                boxes,
                bodies.origin_xy[mine],
                bodies.yaw_rad[mine],
                self._sensors.lidar_model,
            )
            self.scans[mine] = self._sensors.process(rays)

    def _spoil(self, cars: slice) -> None:
        self._disturbances.spoil(self.frames, cars)
