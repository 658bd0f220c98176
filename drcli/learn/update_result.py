"""The result of an update: its statistics, by CleanRL's names, or its error."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import ClassVar

import torch
from torch import nn


@dataclass(frozen=True)
class Stats:
    """Of an epoch, or of another part of an update; `line` is for the log."""

    line: ClassVar[str]
    epoch: int
    learning_rate: float

    def metrics(self) -> dict[str, float]:
        numbers = asdict(self)
        del numbers["epoch"]
        rate = {"charts/learning_rate": numbers.pop("learning_rate")}
        return rate | {f"losses/{name}": number for name, number in numbers.items()}


@dataclass(frozen=True)
class PPOStats(Stats):
    """Means over an epoch's minibatches.

    `approx_kl` is from the policy that drove, `clipfrac` the share of steps outside the clip
    range. The line is as in the reference.
    """

    line = (
        "Policy training> Surrogate loss={0.policy_loss}, KL divergence={0.approx_kl}, "
        "Entropy={0.entropy}"
    )
    policy_loss: float
    value_loss: float
    entropy: float
    approx_kl: float
    clipfrac: float
    explained_variance: float


@dataclass(frozen=True)
class SACStats(Stats):
    """Means over a part of an update; `alpha_loss` is NaN if alpha is fixed."""

    line = (
        "Policy training> Actor loss={0.actor_loss}, Critic loss={0.qf_loss}, Alpha={0.alpha}, "
        "Entropy={0.entropy}"
    )
    actor_loss: float
    qf1_values: float
    qf2_values: float
    qf1_loss: float
    qf2_loss: float
    entropy: float
    alpha: float
    alpha_loss: float

    @property
    def qf_loss(self) -> float:
        return (self.qf1_loss + self.qf2_loss) / 2.0

    def metrics(self) -> dict[str, float]:
        return super().metrics() | {"losses/qf_loss": self.qf_loss}


@dataclass(frozen=True)
class DistillationStats(Stats):
    """How far the student's actions are from the teacher's."""

    line = "Distillation> Imitation loss={0.imitation_loss}"
    imitation_loss: float


class NonFiniteLossError(ArithmeticError):
    """The loss, a return or a weight became NaN or infinite."""


def require_finite_losses(losses: Mapping[str, float]) -> None:
    """Raise NonFiniteLossError if one is NaN or infinite.

    Once per epoch: on a GPU, a check of each minibatch would wait for it.
    """
    if not all(math.isfinite(loss) for loss in losses.values()):
        named = ", ".join(f"{name} {loss:.4g}" for name, loss in losses.items())
        raise NonFiniteLossError(f"A loss of this epoch is not finite ({named}).")


def require_finite_weights(model: nn.Module) -> None:
    """Raise NonFiniteLossError if a weight is NaN or infinite."""
    if not all(bool(torch.isfinite(p).all()) for p in model.parameters()):
        raise NonFiniteLossError("The weights contain NaN or infinite values.")
