"""What the networks of all algorithms have in common."""

from typing import NamedTuple

from torch import Tensor, nn

from drcli.learn.encoders import Encoder
from drcli.learn.policy import Observation, PolicySpec


class Head(NamedTuple):
    """What a network makes of observations, with gradients.

    Attributes:
        raw: Logits, or means that `Network.squash` makes actions of. Shape (n, num_actions).
        std: Of continuous `raw`, else None. Shape (n, num_actions).
        value: In reward; None where nobody asked. Shape (n,).
    """

    raw: Tensor
    std: Tensor | None
    value: Tensor | None


class Network(nn.Module):
    """A `Policy` that can be trained, exported and explained."""

    spec: PolicySpec
    body: Encoder

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `Policy.act`."""
        raise NotImplementedError

    def head(self, seen: Observation, *, judged: bool = False) -> Head:
        """With a value if it is to be `judged`."""
        raise NotImplementedError

    def squash(self, raw: Tensor) -> Tensor:
        """Continuous actions, nominally in [-1, 1]."""
        return raw

    def outputs(self, seen: Observation) -> Tensor:
        """Probabilities, or continuous actions. Shape (n, num_actions)."""
        raw = self.head(seen).raw
        return self.squash(raw) if self.spec.continuous else raw.softmax(-1)
