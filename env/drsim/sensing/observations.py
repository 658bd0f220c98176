"""Camera frames and lidar scans of many cars, refreshed after every step."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from drsim.arrays import Bytes, Floats, Ints, LensParts, Singles
from drsim.car.car import EYES_APART_M, FRONT, CarBatch
from drsim.car.conditions import Conditions, Disturbances
from drsim.errors import require
from drsim.race.solids import CUBOID, Solids
from drsim.race.traffic import Traffic
from drsim.sensing.lighting import Lamps, Lighting
from drsim.sensing.scene import Light, Scene, build_scene, draw_ground, draw_solids, lens_parts
from drsim.sensing.sensors import LIDAR, Sensors, scan
from drsim.track.appearance import LUMA, Look, look_of, look_through
from drsim.track.track import Track
from drsim.track.ways import Ways

if TYPE_CHECKING:
    from drsim.sensing.cuda_camera import CudaCamera

_FRAMES_PER_JOB = 4
_FRAMES_ALONE = 2
"""Until another thread would wake up."""


class Channel(NamedTuple):
    """The usual grey, or the part of one colour; one scene for each track."""

    scenes: Sequence[Scene]
    lighting: Lighting | None = None
    weights: Sequence[float] = LUMA

    def light(self, cars: slice = slice(None)) -> Light | None:
        return None if self.lighting is None else self.lighting.of(cars)


class FrameRenderer:
    """The current frame of every car.

    Threads share the work frame by frame without Python, because the caller computes in Python
    meanwhile.

    Attributes:
        frames: Grey, left eye first, or red, green and blue; rewritten between `start` and
            `finish`. Shape (n, eyes or 3, 120, 160).
    """

    def __init__(
        self,
        channels: Sequence[Channel],
        scene_of: Ints,
        num_threads: int,
        *,
        eyes: int = 1,
        solids: Solids | None = None,
        lamps: Sequence[Lamps] = (),
        after: Callable[[slice], None] | None = None,
        changes: Callable[[Ints], bool] | None = None,
        gpu: "CudaCamera | None" = None,
    ) -> None:
        """`num_threads` render, the caller's included; `scene_of` is that of each car.

        `solids` must not move between `start` and `finish`. `after` gets the rows of rendered
        frames, on the thread that finished them.
        """
        shape = (len(scene_of), eyes * len(channels), FRONT.rows, FRONT.columns)
        self.frames: Bytes = np.zeros(shape, np.uint8) if gpu is None else gpu.frames
        self._gpu = gpu
        self._channels = channels
        self._num_eyes = eyes
        self._scene_of = scene_of
        self._solids = solids
        self._lamps = lamps
        self._after = after
        self._changes = changes
        self._num_threads = num_threads
        self._pool = pool_of(num_threads)
        self._cars: Ints = np.empty(0, np.int64)
        self._pictures: list[tuple[Channel, LensParts, Bytes]] = []
        self._parts: list[tuple[Channel, int, LensParts, Bytes, Ints, Ints]] = []
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
        eyes = self._num_eyes
        for eye in range(eyes):
            to_left_m = (0.5 * (eyes - 1) - eye) * EYES_APART_M
            lenses = lens_parts(
                lens_pos + to_left_m * lens_mat[:, :, 1],
                lens_mat,
                rounding=self.frames.shape[1] > 1,
            )
            for channel in self._channels:
                frames = self.frames[:, len(self._pictures)]
                self._pictures.append((channel, lenses, frames))
        if self._gpu is not None:
            light = self._channels[0].light()
            self._gpu.draw([lenses for _, lenses, _ in self._pictures], cars, light)
            self._gpu.fetch()
            return
        scenes = self._scene_of[cars]
        self._parts = [
            (channel, k, lenses, frames, cars[scenes == k], np.zeros(1, np.int64))
            for k in np.unique(scenes).tolist()
            for channel, lenses, frames in self._pictures
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
            self._pictures, self._parts = [], []
            self._futures = []

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()

    def _draw_ground(self) -> None:
        for channel, k, lenses, frames, cars, taken in self._parts:
            draw_ground(channel.scenes[k], lenses, frames, cars, taken, channel.light())

    def _draw_over(self, rows: slice) -> None:
        lit = [lamps for lamps in self._lamps if lamps.lit(rows)]
        for channel, (pos, mat, focal_px, bias), all_frames in self._pictures:
            lenses, frames = (pos[rows], mat[rows], focal_px, bias), all_frames[rows]
            for lamps in lit:
                lamps.reflect(rows, frames, lenses)
            if self._solids is not None:
                light = channel.light(rows)
                draw_solids(self._solids.boxes[rows], lenses, frames, light, channel.weights)
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


_PAINTERS = 2
"""Each needs up to 0.2 GB for a moment."""

COLORS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Weights of red, green and blue in each channel of colour frames."""


def channels_of(
    tracks: Sequence[Track],
    num_cars: int,
    randomize: Randomize,
    scenes: Sequence[Scene] | None = None,
    *,
    color: bool = False,
) -> list[Channel]:
    """What frames are drawn from; `scenes` are those of the tracks in grey, if built already.

    In colour there are three pictures of each track; with drawn textures, which replace all
    colours, the grey one serves three times.
    """
    looks = [look_of(track.name) for track in tracks]
    textures = randomize == "textures"
    channels = []
    for weights in COLORS if color else (LUMA,):
        if color and not textures:
            scenes = _painted(tracks, [look_through(look, weights) for look in looks])
        scenes = scenes or _painted(tracks, looks)
        lighting = None
        if randomize != "nothing":
            lighting = Lighting(num_cars, looks, textures=textures, weights=weights)
        channels.append(Channel(scenes, lighting, weights))
    return channels


def _painted(tracks: Sequence[Track], looks: Sequence[Look]) -> list[Scene]:
    with ThreadPoolExecutor(min(len(tracks), _PAINTERS)) as pool:
        return list(pool.map(build_scene, tracks, looks))


class Observations(FrameRenderer):
    """Camera frames and lidar scans of n cars.

    Attributes:
        frames: As in `FrameRenderer`.
        scans: Shape (n, d).
    """

    def __init__(
        self,
        scenes: Sequence[Scene] | None,
        num_threads: int,
        *,
        ways: Ways,
        sensors: Sensors,
        traffic: Traffic | None,
        disturbances: Disturbances,
        randomize: Randomize,
        color: bool = False,
        gpu: bool = False,
    ) -> None:
        """`num_threads` render, the caller's included, or a GPU if there is one track.

        Raises:
            OSError: There is no GPU that can be used.
            ValueError: Colours of two eyes.
        """
        require(not color or sensors.eyes == 1, "color", color, f"be False with {sensors.camera}")
        num_cars = len(ways.way)
        self._ways = ways
        self._sensors = sensors
        self._traffic = traffic
        self._disturbances = disturbances
        channels = channels_of(ways.tracks[::2], num_cars, randomize, scenes, color=color)
        camera = None
        if gpu and (len(ways.tracks) > 2 or color):
            raise OSError("a GPU draws one track at a time, in greys")
        if gpu:
            try:
                from drsim.sensing.cuda_camera import CudaCamera  # loads CUDA
            except (ImportError, AttributeError) as error:
                raise OSError(f"numba cannot load CUDA: {error}") from error

            camera = CudaCamera(channels[0].scenes[0], num_cars, eyes=sensors.eyes)
        super().__init__(
            channels,
            ways.road,
            num_threads,
            eyes=sensors.eyes,
            solids=Solids(num_cars, traffic.shapes) if traffic is not None else None,
            lamps=[Lamps(scene, num_cars) for scene in channels[0].scenes],
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
        if self._channels[0].lighting is None:
            return
        begun = random.bit_generator.state
        for channel in self._channels:
            random.bit_generator.state = begun  # every colour draws the same
            if channel.lighting is not None:
                channel.lighting.draw(car, random, int(self._ways.road[car]))
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
            mine, scene = cars[scenes == k], self._channels[0].scenes[k]
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
        self._disturbances.spoil(self.frames, cars, colors=len(self._channels) > 1)
