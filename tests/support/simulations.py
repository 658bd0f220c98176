"""Simulations of one track that share its scene, which takes long to build."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from drsim.episode.reward import RewardFunction, centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.sensing.scene import build_scene
from drsim.track.track import Track


@contextmanager
def simulations(track: Track) -> Iterator[Callable[..., Simulation]]:
    """Builds simulations, and closes all of them in the end."""
    scene = build_scene(track)
    built = []

    def simulate(
        num_cars: int = 1, reward_function: RewardFunction = centre_line_reward, **options: Any
    ) -> Simulation:
        built.append(
            Simulation(
                track, num_cars=num_cars, reward_function=reward_function, scene=scene, **options
            )
        )
        return built[-1]

    yield simulate
    for simulation in built:
        simulation.close()
