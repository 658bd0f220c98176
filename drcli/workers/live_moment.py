"""What the driving loop hands to a live view: one step of all cars, as it is, without work."""

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
    """A car and the episode that it drives.

    Attributes:
        car: Number in the simulation.
        racer: Index of the racer.
        episode: Number of the episode.
        reverse: Whether it drives against the direction of the track.
        rows: Of the episode. The driving loop adds to it later.
        steps: How many rows there were after the step.
    """

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
        cars: Their numbers. Length k.
        frames: Shape (k, eyes, 120, 160).
        seen: The same as the policy takes it, with everything else.
        decision: What it chose.
        policy: The racer's, whose weights change between iterations.
        actions: What they mean.
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
        track: In the direction of the simulation.
        result: The step.
        poses: Origins x, y in metres and yaws in radians. Shape (n, 3).
        speeds_mps: How fast the cars are. Shape (n,).
        steering_deg: What the policies asked for. Shape (n,).
        asked_mps: The same for speeds.
        riders: The cars that drove, by number.
        looks: What they saw.
        shapes: Of the k objects of each car.
        objects: Their x, y and yaw. Shape (n, k, 3).
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
        """What a car saw and its row there; None if it did not drive."""
        for look in self.looks:
            if car in look.cars:
                return look, look.cars.index(car)
        return None


class Onlooker(Protocol):
    """Somebody who may look at the driving.

    Attributes:
        wanted: Whether the next step is wanted. The driving loop asks after every step.
    """

    wanted: bool

    def see(self, moment: Moment) -> None:
        """Take a step; returns at once."""

    def ended(self, episode: Episode, racer: int, world: str) -> None:
        """Note an episode that has ended on that track."""
