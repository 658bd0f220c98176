"""The grid of a robust evaluation: disturbances and starts."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from drcli.exchange.robust_result import NOMINAL_AXIS
from drsim.car.conditions import NOMINAL, Conditions
from drsim.episode.start_poses import Side

PLACES = 4
"""Starts of each level, spread evenly over the lap."""

COMBINATIONS = 4


@dataclass(frozen=True)
class Cell:
    """One level of one disturbance (`axis`); angles are to the left."""

    axis: str
    level: str
    conditions: Conditions = field(default=NOMINAL)
    side: Side = "centre"
    angle_deg: float = 0.0
    other_way: bool = False


def grid(seed: int, *, closed: bool = True) -> list[Cell]:
    """All cells; the seed decides what is drawn for the axis `together`.

    An open track is driven in one direction only.
    """
    cells = [
        Cell(NOMINAL_AXIS, "none"),
        Cell("start", "left", side="left"),
        Cell("start", "right", side="right"),
        Cell("start", "15 deg to the left", angle_deg=15.0),
        Cell("start", "15 deg to the right", angle_deg=-15.0),
        Cell("direction", "the other way", other_way=True),
        *_levels("light", "brightness", (0.35, 0.6, 1.4, 1.9), "x {:g}"),
        *_levels("glare", "glare", (0.5, 1.0), "{:g}"),
        *_levels("reflections", "reflections", (0.5, 1.0), "{:g}"),
        *_levels("noise", "image_noise", (10.0, 25.0, 50.0), "{:g} greys"),
        Cell("camera", "4 deg up", Conditions(camera_turn_deg=(0.0, -4.0, 0.0))),
        Cell("camera", "4 deg down", Conditions(camera_turn_deg=(0.0, 4.0, 0.0))),
        Cell("camera", "4 deg to the left", Conditions(camera_turn_deg=(0.0, 0.0, 4.0))),
        Cell("camera", "4 deg to the right", Conditions(camera_turn_deg=(0.0, 0.0, -4.0))),
        *_levels("latency", "latency_s", (0.03, 0.06, 0.1, 0.15), "{:g} s"),
        *_levels("grip", "friction", (0.4, 0.7, 1.4), "x {:g}"),
        *_levels("battery", "battery", (0.65, 0.85, 1.2), "x {:g}"),
        *_levels("steering trim", "steering_trim_deg", (-8.0, -4.0, 4.0, 8.0), "{:+g} deg"),
        Cell("steering lock", "left x 0.5", Conditions(steering_left=0.5)),
        Cell("steering lock", "right x 0.5", Conditions(steering_right=0.5)),
        *_together(seed),
    ]
    return [cell for cell in cells if closed or not cell.other_way]


def with_patterns(cells: list[Cell], seed: int) -> list[Cell]:
    """With noise and lamps fixed by the seed."""
    patterns = np.random.SeedSequence([seed, 1]).generate_state(len(cells), np.uint64)
    return [
        replace(cell, conditions=replace(cell.conditions, pattern=pattern))
        for cell, pattern in zip(cells, patterns.tolist(), strict=True)
    ]


def _levels(axis: str, name: str, values: tuple[float, ...], words: str) -> Iterator[Cell]:
    for value in values:
        changed: dict[str, Any] = {name: value}
        yield Cell(axis, words.format(value), replace(NOMINAL, **changed))


def _together(seed: int) -> Iterator[Cell]:
    """Mild, as a real car has them."""
    random = np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, 0])))
    for number in range(COMBINATIONS):
        either, share = random.uniform(-1.0, 1.0, 7).tolist(), random.random(4).tolist()
        drawn = Conditions(
            brightness=1.0 + 0.25 * either[0],
            friction=1.0 + 0.2 * either[1],
            battery=1.0 + 0.12 * either[2],
            steering_trim_deg=2.5 * either[3],
            camera_turn_deg=tuple(1.5 * turn for turn in either[4:7]),
            image_noise=8.0 * share[0],
            glare=0.3 * share[1],
            reflections=0.3 * share[2],
            latency_s=0.08 * share[3],
        )
        yield Cell("together", f"draw {number + 1}", drawn)
