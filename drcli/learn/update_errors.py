"""How the update of any algorithm fails. The weights of a failed update must not be kept."""

import torch
from torch import nn


class NonFiniteLossError(ArithmeticError):
    """The loss, a return or a weight became NaN or infinite."""


class UpdateInterruptedError(RuntimeError):
    """The caller asked to stop in the middle of an update."""


def require_finite_weights(model: nn.Module) -> None:
    """Check what an update left.

    Raises:
        NonFiniteLossError: A weight is NaN or infinite.
    """
    if not all(bool(torch.isfinite(p).all()) for p in model.parameters()):
        raise NonFiniteLossError("The weights contain NaN or infinite values.")
