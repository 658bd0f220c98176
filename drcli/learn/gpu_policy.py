"""A policy that chooses on a GPU for cars whose observations come from anywhere."""

import copy
from typing import cast

import torch
from torch import Tensor, nn

from drcli.learn.captured_step import CapturedStep
from drcli.learn.encoders import compute_in
from drcli.learn.policy import Observation, Policy, PolicySpec

ROWS = 32
"""Cars of a call. With another number, a GPU rounds differently."""


class GpuPolicy:
    """Chooses with a copy of a policy on a GPU, as one CUDA graph.

    Always for `ROWS` cars, so an action does not depend on how many others drive.
    """

    def __init__(self, policy: Policy, device: torch.device) -> None:
        assert isinstance(policy, nn.Module)
        self._policy: Policy = policy
        self._source: nn.Module = policy
        self._device = device
        self._twin: nn.Module = policy
        self._format: torch.dtype | None = None
        self._epsilon = torch.zeros((), device=device)
        self._rows: tuple[Tensor, ...] = ()
        self._drawn = CapturedStep(self._choose, device, enabled=device.type == "cuda")
        self._greedy = CapturedStep(self._choose_e_greedy, device, enabled=device.type == "cuda")

    @property
    def spec(self) -> PolicySpec:
        return self._policy.spec

    @property
    def policy(self) -> Policy:
        return self._policy

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
            *(torch.split(each, ROWS) for each in (*seen, noise, deterministic)), strict=True
        )
        # A graph gives its next result in the same memory.
        numbers = torch.cat([step(*self._filled(call))[: len(call[0])].cpu() for call in calls])
        actions = numbers[:, :-2]
        actions = actions.float() if self.spec.continuous else actions[:, 0].long()
        return actions, numbers[:, -2].float(), numbers[:, -1]

    def _filled(self, arguments: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        if not self._rows:
            self._rows = tuple(
                torch.zeros((ROWS, *each.shape[1:]), dtype=each.dtype, device=self._device)
                for each in arguments
            )
        for rows, each in zip(self._rows, arguments, strict=True):
            rows[: len(each)].copy_(each)
        return self._rows

    def _choose(self, *rows: Tensor) -> Tensor:
        return self._packed(rows, None)

    def _choose_e_greedy(self, *rows: Tensor) -> Tensor:
        return self._packed(rows, self._epsilon)

    def _packed(self, rows: tuple[Tensor, ...], epsilon: Tensor | None) -> Tensor:
        frames, scan, state, noise, deterministic = rows
        seen = Observation(frames, scan, state)
        share = cast(float | None, epsilon)  # a graph would never see another float
        twin = cast(Policy, self._twin)
        actions, log_probs, values = twin.act(seen, noise, deterministic, share)
        parts = (actions, log_probs, values)
        return torch.cat([each.double().reshape(len(noise), -1) for each in parts], dim=1)
