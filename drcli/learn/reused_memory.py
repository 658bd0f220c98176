"""Memory of a GPU that holds one rollout after the other at the same addresses."""

import torch
from torch import Tensor

SPARE = 1.25
"""Room for rollouts that are a little longer, so that memory rarely moves."""


class ReusedMemory:
    """Named columns on a device, which each new rollout overwrites.

    Attributes:
        moves: How often a column got another address.
    """

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._held: dict[str, Tensor] = {}
        self.moves = 0

    def place(self, name: str, column: Tensor) -> Tensor:
        """Copy a column to the device.

        Returns:
            The memory of that name. Its first rows are those of `column`; it may have more.

        Raises:
            torch.OutOfMemoryError: There is not enough memory; nothing of that name is held.
        """
        held = self._held.get(name)
        fits = (
            held is not None
            and held.dtype is column.dtype
            and held.shape[1:] == column.shape[1:]
            and len(held) >= len(column)
        )
        if held is None or not fits:
            held = None
            self._held.pop(name, None)
            shape = (round(SPARE * len(column)), *column.shape[1:])
            held = torch.zeros(shape, dtype=column.dtype, device=self._device)
            self._held[name] = held
            self.moves += 1
        held[: len(column)].copy_(column)
        return held
