"""Memory of a GPU that holds one rollout after the other at the same addresses."""

from collections.abc import Callable

import torch
from torch import Tensor

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
