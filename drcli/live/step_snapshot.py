"""What the driving loop hands to a live view: one step of all cars, without work."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol
from weakref import WeakSet

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from drcli.learn.actor_critic import ActorCritic, PolicyAndValue
from drcli.learn.cuda import GpuPolicy
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.learn.encoders import Network
from drcli.learn.policy import Decision, Observation, Policy
from drcli.live.live_record import ShownCar
from drcli.records.trace import Episode, Phase, Row
from drsim.car.actions import Actions
from drsim.episode.episode_rules import StepResult
from drsim.race.solids import Shape
from drsim.track.track import Track

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rider:
    car: int
    racer: int
    episode: int
    phase: Phase
    track: Track
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
class StepSnapshot:
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


class LiveObserver(Protocol):
    """Somebody who may look at the driving.

    The driving loop asks after every step whether the next one is `wanted`.
    """

    wanted: bool

    def see(self, moment: StepSnapshot) -> None:
        """Take a step; returns at once."""

    def ended(self, episode: Episode, racer: int, world: str) -> None:
        """Note an episode that has ended."""


# What the policy of a car made of a step, in numbers, for the live view.


_DIGITS = 4

_CALLS = 8


class PolicyTap:
    """Keeps what PPO's networks say while they choose, so nobody asks them again."""

    def __init__(self) -> None:
        self.active = False
        self._known: WeakSet[ActorCritic] = WeakSet()
        self._calls: deque[tuple[Tensor, Tensor]] = deque(maxlen=_CALLS)

    def follow(self, looks: Sequence[Look]) -> None:
        """Only for the thread that calls these networks."""
        for look in looks:
            policy = _own(look.policy)
            if isinstance(policy, ActorCritic) and policy not in self._known:
                self._known.add(policy)
                policy.register_forward_hook(self._note)

    def take(self) -> list[tuple[Tensor, Tensor]]:
        calls = list(self._calls)
        self._calls.clear()
        return calls

    def _note(self, _module: Any, args: tuple[Any, ...], output: Any) -> None:
        if self.active:
            self._calls.append((args[0].frames, output.policy))


def with_policy(
    shown: ShownCar, look: Look, row: int, calls: Sequence[tuple[Tensor, Tensor]] = ()
) -> ShownCar:
    """The car with what its policy made of a row of the look.

    If that is not among the `calls`, the policy is asked once more, which changes nothing. If
    weights are being loaded just then, the answer may be of neither.
    """
    continuous = look.policy.spec.continuous
    value = float(look.decision.values[row])
    scan = look.seen.scan[row].tolist() if look.frames.size else []  # a teacher sees none
    told = replace(
        shown,
        chosen=None if continuous else int(look.decision.actions[row]),
        value=round(value, _DIGITS) if np.isfinite(value) else None,
        lidar=[round(x, _DIGITS) for x in scan if np.isfinite(x)],
    )
    policy = _own(look.policy)
    seen = look.seen.part(slice(row, row + 1))
    with torch.inference_mode():
        if isinstance(policy, Network):
            raw, std = _output(policy, seen, calls)
            if std is None:
                return replace(told, probabilities=_rounded(raw.double().softmax(-1)[0]))
            return _with_spread(told, look.actions, policy, raw, std)
    return told


def _output(
    policy: Network, seen: Observation, calls: Sequence[tuple[Tensor, Tensor]]
) -> tuple[Tensor, Tensor | None]:
    """Logits or means, and how far draws are from these."""
    if not isinstance(policy, PolicyAndValue):
        raw, std, _ = policy.head(seen)
        return raw, std
    said = _said(seen.frames, calls) if isinstance(policy, ActorCritic) else None
    raw = policy(seen).policy if said is None else said
    return raw, policy.log_std_bounded().exp() if policy.spec.continuous else None


def _own(policy: Policy) -> Policy:
    """In main memory, without what divides the cars among threads."""
    return policy.policy if isinstance(policy, DataParallelPolicy | GpuPolicy) else policy


def _said(frames: Tensor, calls: Sequence[tuple[Tensor, Tensor]]) -> Tensor | None:
    """One car's frames are a part of those of a call."""
    for batch, output in reversed(calls):
        step_bytes = batch.stride(0) * batch.element_size()
        row, rest = divmod(frames.data_ptr() - batch.data_ptr(), max(1, step_bytes))
        if rest == 0 and 0 <= row < len(batch):
            return output[row : row + 1]
    return None


def _with_spread(
    shown: ShownCar, actions: Actions, policy: Network, mean: Tensor, std: Tensor
) -> ShownCar:
    found = []
    for offset in (0.0, -1.0, 1.0):
        asked = actions.requests(policy.squash(mean + offset * std).numpy())
        found.append([round(float(x[0]), _DIGITS) for x in asked])
    return replace(shown, mean=found[0], low=found[1], high=found[2])


def _rounded(values: Tensor) -> list[float] | None:
    numbers = [round(x, _DIGITS) for x in values.tolist()]
    return numbers if all(map(np.isfinite, numbers)) else None
