"""Camera frames and lidar scans of many cars, refreshed after every step."""

from typing import Any, Literal

import numpy as np

from drsim.arrays import Ints, Singles
from drsim.car.car import CarBatch
from drsim.car.conditions import Conditions
from drsim.car.disturbances import Disturbances
from drsim.race.solids import CUBOID, Solids
from drsim.race.traffic import Traffic
from drsim.sensing.frames import FrameRenderer
from drsim.sensing.lamps import Lamps
from drsim.sensing.lidar import LIDAR, scan
from drsim.sensing.lighting import Lighting
from drsim.sensing.scene import Scene
from drsim.sensing.sensors import Sensors
from drsim.track.appearance import look_of

Randomize = Literal["nothing", "lights", "textures"]
"""`lights` are those of the reference's domain randomisation, `textures` also the colours of the
world.
"""


class Observations:
    """Camera frames and lidar scans of n cars.

    Attributes:
        frames: Rewritten between `start` and `finish`. Shape (n, eyes, 120, 160).
        scans: Shape (n, d).
    """

    def __init__(
        self,
        scene: Scene,
        num_cars: int,
        num_threads: int,
        *,
        world: str,
        sensors: Sensors,
        traffic: Traffic | None,
        disturbances: Disturbances,
        randomize: Randomize,
        gpu: bool = False,
    ) -> None:
        """`num_threads` render, the caller's included, or a GPU.

        Raises:
            OSError: There is no GPU that can be used.
        """
        self._scene = scene
        self._sensors = sensors
        self._traffic = traffic
        self._disturbances = disturbances
        self._solids = Solids(num_cars, traffic.shapes) if traffic is not None else None
        textures = randomize == "textures"
        self._lighting = (
            Lighting(num_cars, look_of(world), textures=textures)
            if randomize != "nothing"
            else None
        )
        self._lamps = Lamps(scene, num_cars)
        self._gpu = None
        if gpu:
            try:
                from drsim.sensing.cuda_camera import CudaCamera  # loads CUDA
            except (ImportError, AttributeError) as error:
                raise OSError(f"numba cannot load CUDA: {error}") from error

            self._gpu = CudaCamera(scene, num_cars, eyes=sensors.eyes)
        self._renderer = FrameRenderer(
            scene,
            num_cars,
            num_threads,
            eyes=sensors.eyes,
            solids=self._solids,
            lighting=self._lighting,
            lamps=self._lamps,
            after=self._spoil,
            changes=disturbances.spoils,
            gpu=self._gpu,
        )
        self.frames = self._renderer.frames
        nothing = np.full((num_cars, LIDAR.samples), np.inf, np.float32)
        self.scans: Singles = sensors.process(nothing)

    @property
    def device_frames(self) -> Any:
        """With the interface of CUDA arrays; None without a GPU."""
        return None if self._gpu is None else self._gpu.device_frames

    def draw(self, car: int, random: np.random.Generator) -> None:
        if self._lighting is None:
            return
        self._lighting.draw(car, random)
        if self._solids is not None and self._traffic is not None:
            colors = random.uniform(0.0, 255.0, (1, len(self._traffic.shapes), 3))
            self._solids.paint(np.array([car]), colors)

    def light(self, car: int, conditions: Conditions) -> None:
        self._lamps.begin(
            car,
            glare=conditions.glare,
            reflections=conditions.reflections,
            pattern=conditions.pattern,
        )

    def start(self, cars: Ints, bodies: CarBatch) -> None:
        if self._solids is not None and self._traffic is not None:
            self._solids.move(cars, self._traffic.xy[cars], self._traffic.yaw_rad[cars])
        lens_pos, lens_mat = self._disturbances.lenses(bodies.lens_pos, bodies.lens_mat)
        self._disturbances.next_frames(cars)
        self._renderer.start(cars, lens_pos, lens_mat)
        if self._sensors.lidar and len(cars):
            self._scan(cars, bodies)

    def finish(self) -> None:
        self._renderer.finish()

    def close(self) -> None:
        self._renderer.close()

    def _scan(self, cars: Ints, bodies: CarBatch) -> None:
        boxes = np.empty((len(cars), 0), CUBOID)
        if self._solids is not None:
            boxes = self._solids.boxes[cars]
        rays = scan(
            self._scene.walls_m,
            self._scene.wall_height_m,
            boxes,
            bodies.origin_xy[cars],
            bodies.yaw_rad[cars],
            self._sensors.lidar_model,
        )
        self.scans[cars] = self._sensors.process(rays)

    def _spoil(self, cars: slice) -> None:
        self._disturbances.spoil(self.frames, cars)
