"""The policy at the wheel: what the car perceives in, actions out, nothing to learn."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from drcli.learn.network_spec import PolicySpec
from drcli.learn.observation import Observation

Singles = NDArray[np.float32]

FEWEST_CARS = 4
"""Cars of a part; the convolutions of fewer are hardly faster."""


class Policy(Protocol):
    """A network that can drive."""

    @property
    def spec(self) -> PolicySpec:
        """What it perceives and chooses from."""

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Choose an action for each of n cars.

        Args:
            seen: What each car perceives.
            noise: Random numbers. Shape (n, noise_dims).
            deterministic: Which cars take the most likely action. Shape (n,).
            epsilon: Share of the other actions that are drawn blindly, where the rest are the most
                likely ones; None where they are drawn from the policy.

        Returns:
            Actions, their log-probabilities, and the critic's estimates in reward, float64. Each
            of length n.
        """


class SideBySide:
    """A policy that chooses for parts of the cars at the same time, one thread for each part.

    Threads inside operations wait for each other at every one of them. They are 1.1 times as fast
    on two quiet cores, but half as fast as this where another program runs beside. What calls this
    should therefore do without them: `torch.set_num_threads(1)`.
    """

    def __init__(self, policy: Policy, threads: int) -> None:
        """Prepare.

        Args:
            policy: The network, on the CPU.
            threads: Most parts.
        """
        self._policy = policy
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads, "policy") if threads > 1 else None

    @property
    def spec(self) -> PolicySpec:
        """What the policy perceives and chooses from."""
        return self._policy.spec

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Choose an action for each car; see `Policy.act`."""
        cars = len(noise)
        count = min(self._threads, cars // FEWEST_CARS)
        if self._pool is None or count < 2:
            return self._policy.act(seen, noise, deterministic, epsilon)

        def part(cars: slice) -> tuple[Tensor, Tensor, Tensor]:
            own = Observation(*(column[cars] for column in seen))
            with torch.inference_mode():  # counts for one thread only
                return self._policy.act(own, noise[cars], deterministic[cars], epsilon)

        bounds = [cars * number // count for number in range(count + 1)]
        actions, log_probs, values = zip(
            *self._pool.map(part, [slice(*ends) for ends in pairwise(bounds)]), strict=True
        )
        return torch.cat(actions), torch.cat(log_probs), torch.cat(values)


@dataclass(frozen=True)
class Decision:
    """What the policy chose for n cars, and what the learner will want to know of it.

    Attributes:
        actions: int64 indices of shape (n,), or unclipped float32 values of shape (n, dims).
        log_probs: Log-probability of each action. Shape (n,).
        values: The critic's estimate. Shape (n,).
    """

    actions: NDArray[np.int64] | Singles
    log_probs: Singles
    values: NDArray[np.float64]


def noise_dims(policy: Policy) -> int:
    """Random numbers that one choice takes.

    Standard normal ones for each continuous dimension; else two uniform ones in [0, 1): the first
    decides what is drawn, the second whether it is drawn blindly.
    """
    return policy.spec.num_actions if policy.spec.continuous else 2


def observation(frames: NDArray[np.uint8], scans: Singles, states: Singles) -> Observation:
    """What n cars perceive, as tensors that share the arrays' memory."""
    return Observation(*(torch.from_numpy(array) for array in (frames, scans, states)))


def decide(
    policy: Policy,
    seen: Observation,
    noise: Singles,
    deterministic: NDArray[np.bool_],
    epsilon: float | None = None,
) -> Decision:
    """Choose an action for each car.

    Args:
        policy: The network, on the CPU.
        seen: What each car perceives.
        noise: Random numbers. Shape (n, noise_dims).
        deterministic: Which cars take the most likely action instead. Shape (n,).
        epsilon: As in `Policy.act`.
    """
    with torch.inference_mode():
        chosen = policy.act(seen, torch.from_numpy(noise), torch.from_numpy(deterministic), epsilon)
    return Decision(*(tensor.numpy() for tensor in chosen))
