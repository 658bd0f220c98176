"""What goes into the Gymnasium environments, checked, and what comes out of them."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from drsim.episode.simulation import Simulation
from drsim.episode.step import StepResult
from drsim.sensing.sensors import Sensors

Perceived = Any
"""An array, or a dict of arrays by sensor name."""


def check_choice(name: str, value: Any, choices: tuple[Any, ...]) -> None:
    """Refuse a word that is none of those expected.

    Raises:
        ValueError: Names them.
    """
    if value not in choices:
        words = ", ".join(repr(choice) for choice in choices)
        raise ValueError(f"{name} is {value!r}; it must be one of {words}.")


def check_start(start: Any) -> None:
    """Refuse a start that is no place on the lap.

    Raises:
        ValueError: It is neither None nor a number from 0 to 1.
    """
    if start is None:
        return
    if not isinstance(start, (float, int, np.number)) or not 0 <= start <= 1:
        raise ValueError(f"start is {start!r}; it must be 0 .. 1 of the lap, or None for anywhere.")


def checked_actions(given: Any, space: gym.Space[Any], batch: tuple[int, ...] = ()) -> NDArray[Any]:
    """Actions as an array, if they mean anything.

    Args:
        given: Numbers of one car, or of many.
        space: Action space of one car.
        batch: `(n,)` for n cars.

    Raises:
        ValueError: They have not the shape or the type of the space, are no choice of a list, or
            are no numbers. Continuous actions beyond -1 .. 1 are good: they count as -1 or 1.
    """
    actions = np.asarray(given)
    good = actions.shape == (*batch, *(space.shape or ()))
    if isinstance(space, gym.spaces.Discrete):
        good = good and actions.dtype.kind in "iu"
        good = good and bool(((actions >= 0) & (actions < space.n)).all())
    else:
        good = good and actions.dtype.kind in "fiu" and bool(np.isfinite(actions).all())
    if not good:
        cars = f" for {batch[0]} cars" if batch else ""
        raise ValueError(f"{given!r} is no action of {space}{cars}.")
    return actions


def start_of(
    random: np.random.Generator,
    count: int,
    start: float | None,
    reverse: bool,
    options: dict[str, Any] | None,
) -> tuple[NDArray[np.float64], bool]:
    """Where episodes start, and which way they drive; options win over the arguments.

    Returns:
        Fractions of the lap, shape (count,), and the direction.

    Raises:
        ValueError: The start is no place on the lap, or an option has another name.
    """
    options = options or {}
    for name in options:
        check_choice("An option of reset", name, ("start", "reverse"))
    start = options.get("start", start)
    check_start(start)
    fractions = random.random(count) if start is None else np.full(count, float(start))
    return fractions, bool(options.get("reverse", reverse))


def perceived(simulation: Simulation, sensors: Sensors, cars: int | slice) -> Perceived:
    """What cars perceive, as their observation space has it: copies, eyes last."""
    frames = np.moveaxis(simulation.frames[cars], -3, -1).copy()
    if sensors.lidar is None:
        return frames
    return {sensors.camera: frames, sensors.lidar: simulation.scans[cars].copy()}


def info_of(result: StepResult) -> dict[str, Any]:
    """What `info` tells of all cars; arrays of shape (n,)."""
    names = (
        "progress",
        "status",
        "steps",
        "laps",
        "lap_time_s",
        "x",
        "y",
        "yaw_deg",
        "closest_waypoint",
        "all_wheels_on_track",
        "crashes",
        "driven",
    )
    return {name: getattr(result, name) for name in names}
