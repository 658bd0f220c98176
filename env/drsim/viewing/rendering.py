"""Pictures of a simulation for people: what a car sees, the track around it, and a window."""

from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from drsim.car.car import CONTROL_HZ
from drsim.episode.simulation import Simulation
from drsim.viewing.spectator import Spectator

Frame = NDArray[np.uint8]

RENDER_MODES = ("rgb_array", "human")
VIEWS = ("camera", "chase", "top")


class CameraMan:
    """Pictures of the cars of a simulation, for people."""

    def __init__(self, simulation: Simulation, view: str) -> None:
        self._simulation = simulation
        self._view = view
        self._spectator: Spectator | None = None
        if view != "camera":
            traffic = simulation.traffic
            shapes = traffic.shapes if traffic is not None else ()
            self._spectator = Spectator(simulation.track, shapes)

    def cut(self) -> None:
        """An episode begins: the camera behind the car need not swing there."""
        if self._spectator is not None:
            self._spectator.cut()

    def cut_to(self, car: int) -> Frame:
        """The picture of one car among many, along which the camera behind it looks at once."""
        self.cut()
        return self.picture(car)

    def picture(self, car: int) -> Frame:
        """What the chosen view shows of a car, RGB."""
        if self._spectator is None:
            return np.repeat(self._simulation.frames[car, 0, :, :, None], 3, axis=2)
        pose = self._simulation.poses[car]
        traffic = self._simulation.traffic
        objects = None
        if traffic is not None:
            objects = np.column_stack([traffic.xy[car], traffic.yaw_rad[car]])
        if self._view == "chase":
            return self._spectator.chase(pose, objects)
        return self._spectator.top(pose, objects)


class Window:
    """A window that shows one picture after the other, in time with the simulation."""

    def __init__(self) -> None:
        """Open it.

        Raises:
            DependencyNotInstalled: The package pygame is missing.
        """
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

    def show(self, picture: Frame) -> None:
        """Show a picture of any size, and wait until 1/15 s has passed since the last one."""
        columns_first = np.ascontiguousarray(picture.swapaxes(0, 1))
        surface = self._pygame.surfarray.make_surface(columns_first)
        self._pygame.transform.scale(surface, self._screen.get_size(), self._screen)
        self._pygame.event.pump()
        self._pygame.display.flip()
        self._clock.tick(CONTROL_HZ)

    def close(self) -> None:
        """Close it."""
        self._pygame.display.quit()


_WINDOW_PX = (640, 480)
