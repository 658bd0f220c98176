"""Checks of what users pass to the Gymnasium environments."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Floats
from drsim.car.conditions import Conditions
from drsim.episode.simulation import Simulation
from drsim.episode.step import StepResult
from drsim.sensing.sensors import Sensors


def check_choice(name: str, value: Any, choices: tuple[Any, ...]) -> None:
    """Raise ValueError for a value that is not one of the choices."""
    if value not in choices:
        words = ", ".join(repr(choice) for choice in choices)
        raise ValueError(f"{name} is {value!r}; it must be one of {words}.")


def check_start(start: Any) -> None:
    """Raise ValueError for a start that is neither None nor 0 to 1."""
    if start is None:
        return
    if not isinstance(start, (float, int, np.number)) or not 0 <= start <= 1:
        raise ValueError(f"start is {start!r}; it must be 0 .. 1 of the lap, or None for anywhere.")


def checked_actions(given: Any, space: gym.Space[Any], batch: tuple[int, ...] = ()) -> NDArray[Any]:
    """Actions as an array; continuous ones beyond -1 .. 1 are accepted.

    Raises:
        ValueError: They do not have the space's shape or type, are not among its choices, or are
            not finite.
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
        raise ValueError(f"{given!r} is not an action of {space}{cars}.")
    return actions


def start_of(
    random: np.random.Generator,
    count: int,
    start: float | None,
    reverse: bool,
    options: dict[str, Any] | None,
) -> tuple[Floats, bool]:
    """Where episodes start, 0 .. 1 of the lap, shape (count,), and whether in reverse.

    Options win over arguments; ValueError for a wrong one.
    """
    options = options or {}
    for name in options:
        check_choice("An option of reset", name, ("start", "reverse", "conditions"))
    start = options.get("start", start)
    check_start(start)
    fractions = random.random(count) if start is None else np.full(count, float(start))
    return fractions, bool(options.get("reverse", reverse))


def conditions_of(options: dict[str, Any] | None) -> Conditions | list[Conditions] | None:
    """From the options of `reset`: for all cars, or one for each; ValueError for another type."""
    given = (options or {}).get("conditions")
    if given is None or isinstance(given, Conditions):
        return given
    if isinstance(given, (list, tuple)) and all(isinstance(each, Conditions) for each in given):
        return list(given)
    raise ValueError(
        f"conditions is {given!r}; it must be drsim.Conditions, or a list with one for each car."
    )


# What both environments return: observations and info.


Perceived = Any
"""An array, or a dict of arrays by sensor name."""

_INFO = (
    *("progress", "status", "steps", "laps", "lap_time_s", "x", "y", "yaw_deg"),
    *("closest_waypoint", "all_wheels_on_track", "crashes", "driven"),
)


def perceived(simulation: Simulation, sensors: Sensors, cars: int | slice) -> Perceived:
    """Copies, eyes last."""
    frames = np.moveaxis(simulation.frames[cars], -3, -1).copy()
    if sensors.lidar is None:
        return frames
    return {sensors.camera: frames, sensors.lidar: simulation.scans[cars].copy()}


def info_of(result: StepResult) -> dict[str, Any]:
    return {name: getattr(result, name) for name in _INFO}
