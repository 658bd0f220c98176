"""What the driving loop hands to a live view: one step of all cars, without work."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from drcli.exchange.trace import Episode, Phase, Row
from drcli.learn.policy import Decision, Observation, Policy
from drsim.car.actions import Actions
from drsim.episode.step import StepResult
from drsim.race.solids import Shape
from drsim.track.track import Track

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rider:
    car: int
    racer: int
    episode: int
    phase: Phase
    reverse: bool
    rows: list[Row]
    steps: int


@dataclass(frozen=True, eq=False)
class Look:
    """What some cars of a racer saw, and what their policy made of it.

    Attributes:
        cars: Length k.
        frames: Shape (k, eyes, 120, 160).
        policy: Its weights change between iterations.
    """

    cars: list[int]
    frames: NDArray[np.uint8]
    seen: Observation
    decision: Decision
    policy: Policy
    actions: Actions


@dataclass(frozen=True, eq=False)
class Moment:
    """All cars after a step. Nothing in it changes later, but for the rows and the weights.

    Attributes:
        step_s: Unix time of its end.
        poses: Origins x, y in metres and yaws in radians. Shape (n, 3).
        speeds_mps: Shape (n,).
        steering_deg: What the policies asked for. Shape (n,).
        asked_mps: The same for speeds.
        shapes: Of the k objects of each car.
        objects: x, y and yaw. Shape (n, k, 3).
        calls: Frames and outputs of the networks, where they are known.
    """

    step_s: float
    track: Track
    result: StepResult
    poses: Floats
    speeds_mps: Floats
    steering_deg: Floats
    asked_mps: Floats
    riders: Sequence[Rider]
    looks: Sequence[Look]
    shapes: Sequence[Shape]
    objects: Floats
    calls: Sequence[tuple[Tensor, Tensor]] = ()

    def look_of(self, car: int) -> tuple[Look, int] | None:
        for look in self.looks:
            if car in look.cars:
                return look, look.cars.index(car)
        return None


class Onlooker(Protocol):
    """Somebody who may look at the driving.

    The driving loop asks after every step whether the next one is `wanted`.
    """

    wanted: bool

    def see(self, moment: Moment) -> None:
        """Take a step; returns at once."""

    def ended(self, episode: Episode, racer: int, world: str) -> None:
        """Note an episode that has ended."""
