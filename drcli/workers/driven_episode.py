"""An episode of a worker: what is planned, and what the learner gets of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drcli.exchange.rollout import Episodes
from drcli.exchange.trace import Episode, Phase
from drcli.learn.rollout_buffer import Rollout
from drsim.car.conditions import Conditions


@dataclass(frozen=True)
class Plan:
    """An episode to drive.

    Attributes:
        phase: Training samples from the policy, evaluation takes its most likely action.
        start_fraction: Of the lap.
        attempt: How often it was declared broken before.
        offset_m: To the left of the centre line.
        angle_deg: To the left.
        conditions: Instead of what the settings draw.
        world: Decides the seed; None for its own number.
    """

    number: int
    phase: Phase
    start_fraction: float
    reverse: bool = False
    racer: int = 0
    attempt: int = 0
    offset_m: float = 0.0
    angle_deg: float = 0.0
    conditions: Conditions | None = None
    world: int | None = None

    def seed(self, run: int) -> int:
        """Seed of everything random in the episode's world.

        It is the same for all racers of a race, and for each checkpoint of an evaluation, so
        that these can be compared.
        """
        number = self.number if self.world is None else self.world
        words = [run, number, int(self.phase == "evaluation")]
        if self.attempt:
            words.append(self.attempt)
        return int(np.random.SeedSequence(words).generate_state(1, np.uint64)[0])


@dataclass
class Driven(Episode):
    """An episode with the learner's data of each step except the first.

    Attributes:
        frames: Each of shape (eyes, 120, 160).
        scans: Lidar. Each of shape (scan_dims,).
        states: What only the critic sees. Each of shape (state_dims,).
        actions: An index, or unclipped values of shape (dims,).
        learned: Whether the reward is known.
        cut: The step limit ended it.
        last_value: The critic's estimate of the rest then.
        objects: x, y and yaw of what was around the car at each row. Each of shape (k, 3).
    """

    racer: int = 0
    frames: list[NDArray[np.uint8]] = field(default_factory=list)
    scans: list[NDArray[np.float32]] = field(default_factory=list)
    states: list[NDArray[np.float32]] = field(default_factory=list)
    actions: list[NDArray[np.float32] | int] = field(default_factory=list)
    log_probs: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    learned: list[bool] = field(default_factory=list)
    cut: bool = False
    last_value: float = 0.0
    objects: list[NDArray[np.float64]] = field(default_factory=list)


def columns_of(driven: Sequence[Driven]) -> tuple[list[float], list[float], list[float]]:
    """Progress in percent, reward, and times of completed laps."""
    return (
        [float(e.progress) for e in driven],
        [float(e.reward) for e in driven],
        [float(e.duration_s) for e in driven if e.completed],
    )


def rollout_of(driven: Sequence[Driven]) -> Rollout:
    """None of the episodes may be discarded: nobody may learn from these."""
    return Rollout(
        frames=np.stack([frame for e in driven for frame in e.frames]),
        actions=np.array([action for e in driven for action in e.actions]),
        log_probs=np.array([p for e in driven for p in e.log_probs], np.float32),
        values=np.array([v for e in driven for v in e.values]),
        rewards=np.array([row.reward for e in driven for row in e.rows[1:]]),
        lengths=np.array([e.steps for e in driven]),
        last_values=np.array([e.last_value for e in driven]),
        cut=np.array([e.cut for e in driven]),
        scans=np.stack([scan for e in driven for scan in e.scans]),
        states=np.stack([state for e in driven for state in e.states]),
        learned=np.array([each for e in driven for each in e.learned]),
    )


def episodes_of(driven: Sequence[Driven]) -> Episodes:
    """The frames of the episodes are freed."""
    rollout = rollout_of(driven)
    for episode in driven:
        episode.frames.clear()
    return Episodes(
        rollout,
        numbers=np.array([e.number for e in driven]),
        progress=np.array([e.progress for e in driven]),
        completed=np.array([e.completed for e in driven]),
        duration_s=np.array([e.duration_s for e in driven]),
    )
