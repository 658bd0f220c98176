"""Repeats a gradient step on a GPU as one CUDA graph.

A GPU computes most of its 115 operations faster than Python starts them.
"""

import copy
from collections.abc import Callable
from functools import partial
from typing import cast

import torch
from torch import Tensor, nn

from drcli.learn.encoders import compute_in
from drcli.learn.policy import Observation, Policy

WARM_UP = 3
"""They choose algorithms and make the optimizer's state."""


class CapturedStep:
    """A step that is called with tensors of the same shapes again and again.

    What it reads besides its arguments must stay at the same addresses until `forget`.
    """

    def __init__(self, step: Callable[..., Tensor], device: torch.device, *, enabled: bool) -> None:
        """Prepare; `step` may not wait for the GPU."""
        self._step = step
        self._device = device
        self.enabled = enabled
        self._calls = 0
        self._graph: torch.cuda.CUDAGraph | None = None
        self._arguments: tuple[Tensor, ...] = ()
        self._result = torch.empty(0)
        self.failure: str | None = None

    def forget(self) -> None:
        self._graph = None
        self._arguments = ()
        self._calls = 0

    def __call__(self, *arguments: Tensor) -> Tensor:
        """Take the step. The next call may overwrite the result."""
        if not self.enabled or self.failure is not None:
            return self._step(*arguments)
        if self._graph is not None:
            if not _fit(arguments, self._arguments):
                return self._step(*arguments)
            for own, given in zip(self._arguments, arguments, strict=True):
                own.copy_(given)
            self._graph.replay()
            return self._result
        if self._calls and not _fit(arguments, self._arguments):
            self._calls = 0
        self._arguments = arguments
        self._calls += 1
        if self._calls <= WARM_UP:
            return self._step(*arguments)
        self._capture()
        return self(*arguments)

    def _capture(self) -> None:
        self._arguments = tuple(
            argument.to(self._device, copy=True) for argument in self._arguments
        )
        graph = torch.cuda.CUDAGraph()
        try:
            # Other threads may use the GPU meanwhile, as to save the optimizer's state.
            with torch.cuda.graph(graph, capture_error_mode="thread_local"):
                self._result = self._step(*self._arguments)
        except RuntimeError as error:
            torch.cuda.synchronize()
            self.failure = (str(error).splitlines() or [type(error).__name__])[0]
            self._arguments = ()
            return
        self._graph = graph


def _fit(arguments: tuple[Tensor, ...], others: tuple[Tensor, ...]) -> bool:
    return len(arguments) == len(others) and all(
        given.shape == own.shape and given.dtype is own.dtype
        for given, own in zip(arguments, others, strict=True)
    )


# Memory of a GPU that holds one rollout after the other at the same addresses.


ROWS = 1024
SPARE = 1.25
"""So that memory rarely moves."""


class ReusedMemory:
    """Named columns on a device, which each new rollout overwrites."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._held: dict[str, Tensor] = {}
        self.moves = 0

    def place(
        self, name: str, column: Tensor, prepare: Callable[[Tensor], Tensor] = lambda rows: rows
    ) -> Tensor:
        """Copy a column to the device, and `prepare` a few of its rows at a time.

        The result may have more rows.

        Raises:
            torch.OutOfMemoryError: Nothing of that name is held then.
        """
        pattern = prepare(column[:1].to(self._device))
        held = self._held.get(name)
        fits = (
            held is not None
            and held.dtype is pattern.dtype
            and held.shape[1:] == pattern.shape[1:]
            and len(held) >= len(column)
        )
        if held is None or not fits:
            held = None
            self._held.pop(name, None)
            shape = (round(SPARE * len(column)), *pattern.shape[1:])
            held = torch.zeros(shape, dtype=pattern.dtype, device=self._device)
            self._held[name] = held
            self.moves += 1
        for first in range(0, len(column), ROWS):
            rows = column[first : first + ROWS]
            held[first : first + len(rows)] = prepare(rows.to(self._device))
        return held


# A policy that chooses on a GPU for cars whose observations come from anywhere.


POLICY_ROWS = 32
"""Cars of a call. With another number, a GPU rounds differently."""


class GpuPolicy:
    """Chooses with a copy of a policy on a GPU, as one CUDA graph.

    Always for `ROWS` cars, so an action does not depend on how many others drive.
    """

    def __init__(self, policy: Policy, device: torch.device) -> None:
        assert isinstance(policy, nn.Module)
        self.policy: Policy = policy
        self.spec = policy.spec
        self._source: nn.Module = policy
        self._device = device
        self._twin: nn.Module = policy
        self._format: torch.dtype | None = None
        self._epsilon = torch.zeros((), device=device)
        self._rows: tuple[Tensor, ...] = ()
        on_gpu = device.type == "cuda"
        self._drawn = CapturedStep(partial(self._choose, None), device, enabled=on_gpu)
        # A graph would never see another float.
        share = cast(float, self._epsilon)
        self._greedy = CapturedStep(partial(self._choose, share), device, enabled=on_gpu)

    def follow(self, number_format: torch.dtype) -> None:
        """Copy the present weights, with bodies in this format."""
        if number_format is not self._format:
            self._twin = copy.deepcopy(self._source).to(self._device)
            compute_in(self._twin, number_format)
            self._format = number_format
            self._drawn.forget()
            self._greedy.forget()
        own = self._twin.state_dict()
        with torch.no_grad():
            for name, tensor in self._source.state_dict().items():
                own[name].copy_(tensor)

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        if epsilon is not None:
            self._epsilon.fill_(epsilon)
        step = self._drawn if epsilon is None else self._greedy
        calls = zip(
            *(torch.split(each, POLICY_ROWS) for each in (*seen, noise, deterministic)), strict=True
        )
        # A graph gives its next result in the same memory.
        numbers = torch.cat([step(*self._filled(call))[: len(call[0])].cpu() for call in calls])
        actions = numbers[:, :-2]
        actions = actions.float() if self.spec.continuous else actions[:, 0].long()
        return actions, numbers[:, -2].float(), numbers[:, -1]

    def _filled(self, arguments: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        if not self._rows:
            self._rows = tuple(
                torch.zeros((POLICY_ROWS, *each.shape[1:]), dtype=each.dtype, device=self._device)
                for each in arguments
            )
        for rows, each in zip(self._rows, arguments, strict=True):
            rows[: len(each)].copy_(each)
        return self._rows

    def _choose(self, epsilon: float | None, *rows: Tensor) -> Tensor:
        frames, scan, state, noise, deterministic = rows
        twin = cast(Policy, self._twin)
        parts = twin.act(Observation(frames, scan, state), noise, deterministic, epsilon)
        return torch.cat([each.double().reshape(len(noise), -1) for each in parts], dim=1)
