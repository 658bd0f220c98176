"""Gymnasium's render modes, and a window for them."""

from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled

from drsim.arrays import Bytes
from drsim.car.car import CONTROL_HZ
from drsim.episode.simulation import Simulation
from drsim.race.solids import SHAPES
from drsim.viewing.car_eye import FollowingCamera, lens_above
from drsim.viewing.placed_objects import OPPONENT_COLOR, PlacedObject
from drsim.viewing.world_view import WorldView

RENDER_MODES = ("rgb_array", "human")
VIEWS = ("camera", "chase", "top")

_CAR = SHAPES["race_car"]


class Viewer:
    """Pictures of the cars of a simulation."""

    def __init__(self, simulation: Simulation, view: str) -> None:
        self._simulation = simulation
        self._view = view
        self._world: WorldView | None = None
        self._behind = FollowingCamera()

    def __getstate__(self) -> dict[str, Any]:
        """The painted world is large: a copy paints its own."""
        return {**self.__dict__, "_world": None}

    def cut(self) -> None:
        self._behind.cut()

    def cut_to(self, car: int) -> Bytes:
        self.cut()
        return self.picture(car)

    def picture(self, car: int) -> Bytes:
        """The chosen view of a car. The first that is not the camera's takes about 1 s."""
        if self._view == "camera":
            frames = self._simulation.frames[car]
            return np.stack(frames if self._simulation.color else [frames[0]] * 3, axis=-1)
        if self._world is None:
            self._world = WorldView(self._simulation.track, threads=1)
        things = self._things(car)
        if self._view == "chase":
            return self._world.frame(self._behind.lens(things[0].pose), things)
        return self._world.frame(lens_above(self._simulation.track, self._world.size), things)

    def _things(self, car: int) -> list[PlacedObject]:
        x, y, yaw = self._simulation.poses[car].tolist()
        steering_rad, rolled_m = self._simulation.wheels[car].tolist()
        things = [PlacedObject(_CAR, (x, y, yaw), steering_rad=steering_rad, rolled_m=rolled_m)]
        traffic = self._simulation.traffic
        if traffic is not None:
            poses = np.column_stack([traffic.xy[car], traffic.yaw_rad[car]]).tolist()
            for shape, (x, y, yaw) in zip(traffic.shapes, poses, strict=True):
                color = OPPONENT_COLOR if shape is _CAR else None
                things.append(PlacedObject(shape, (x, y, yaw), color))
        return things


class Window:
    """A window, in time with the simulation."""

    def __init__(self) -> None:
        """DependencyNotInstalled where the package pygame is missing."""
        try:
            import pygame
        except ImportError:
            raise DependencyNotInstalled(
                'render_mode="human" needs the package pygame, which the extra "rendering" brings: '
                "`scripts/install.sh rendering` in the project's folder, or `pip install "
                'pygame-ce`. Or choose render_mode="rgb_array".'
            ) from None
        self._pygame: Any = pygame
        pygame.display.init()
        pygame.display.set_caption("DeepRacer")
        self._screen: Any = pygame.display.set_mode(_WINDOW_PX)
        self._clock: Any = pygame.time.Clock()

    def show(self, picture: Bytes) -> None:
        """Waits until 1/15 s has passed since the last one."""
        columns_first = np.ascontiguousarray(picture.swapaxes(0, 1))
        surface = self._pygame.surfarray.make_surface(columns_first)
        self._pygame.transform.scale(surface, self._screen.get_size(), self._screen)
        self._pygame.event.pump()
        self._pygame.display.flip()
        self._clock.tick(CONTROL_HZ)

    def close(self) -> None:
        self._pygame.display.quit()


_WINDOW_PX = (640, 480)
