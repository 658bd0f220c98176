"""Repeats a gradient step on a GPU as one CUDA graph.

A GPU computes most of its 115 operations faster than Python starts them.
"""

from collections.abc import Callable

import torch
from torch import Tensor

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

    @property
    def is_captured(self) -> bool:
        return self._graph is not None

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
