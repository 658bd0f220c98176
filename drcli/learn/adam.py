"""The Adam optimizer, whose state can be stored as named tensors."""

from collections.abc import Iterable

import torch
from torch import Tensor
from torch.optim.adam import adam

MOMENTS = ("exp_avg", "exp_avg_sq")
BETAS = (0.9, 0.999)


class Adam:
    """Adam (Kingma and Ba, 2015, algorithm 1), fused.

    `torch.optim.Adam` always loads PyTorch's compiler: 70 MB and more than a second per process.
    """

    def __init__(self, parameters: Iterable[Tensor], lr: float, eps: float = 1e-8) -> None:
        self._parameters = list(parameters)
        # On a GPU a tensor, because a CUDA graph would never see another number.
        self._lr: float | Tensor = lr
        if self._parameters and self._parameters[0].is_cuda:
            self._lr = torch.tensor(lr, device=self._parameters[0].device)
        self.lr = lr
        self._eps = eps
        self._state: dict[int, dict[str, Tensor]] = {}

    @property
    def lr(self) -> float:
        return self._rate

    @lr.setter
    def lr(self, rate: float) -> None:
        self._rate = rate
        if isinstance(self._lr, Tensor):
            self._lr.fill_(rate)
        else:
            self._lr = rate

    def zero_grad(self) -> None:
        for parameter in self._parameters:
            parameter.grad = None

    @torch.no_grad()
    def step(self) -> None:
        due = [i for i, p in enumerate(self._parameters) if p.grad is not None]
        for index in due:
            if index not in self._state:
                self._state[index] = self._first_state(self._parameters[index])
        column = {name: [self._state[i][name] for i in due] for name in ("step", *MOMENTS)}
        adam(
            [self._parameters[i] for i in due],
            [g for p in self._parameters if (g := p.grad) is not None],
            column["exp_avg"],
            column["exp_avg_sq"],
            [],
            column["step"],
            fused=True,
            amsgrad=False,
            beta1=BETAS[0],
            beta2=BETAS[1],
            lr=self._lr,
            weight_decay=0.0,
            eps=self._eps,
            maximize=False,
        )

    def tensors(self) -> dict[str, Tensor]:
        """The state by names of `torch.optim.Adam`: not copies, and empty before the first step."""
        return {
            f"{index}.{name}": value.contiguous()
            for index, state in self._state.items()
            for name, value in state.items()
        }

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Continue with a copy of a state that `tensors` returned.

        Raises:
            ValueError: It belongs to other parameters; nothing was changed.
        """
        state: dict[int, dict[str, Tensor]] = {}
        indices = {str(index): index for index in range(len(self._parameters))}
        for key, value in tensors.items():
            text, _, name = key.partition(".")
            if text not in indices or name not in ("step", *MOMENTS):
                raise ValueError(f"An optimizer of {len(indices)} parameters has no {key}.")
            index = indices[text]
            if index not in state:
                state[index] = self._first_state(self._parameters[index])
            own = state[index][name]
            if own.shape != value.shape:
                shapes = tuple(value.shape), tuple(own.shape)
                raise ValueError(f"{key} is of shape {shapes[0]}, not {shapes[1]}.")
            own.copy_(value)
        self._state = state

    @staticmethod
    def _first_state(parameter: Tensor) -> dict[str, Tensor]:
        moments = {name: torch.zeros_like(parameter.detach()) for name in MOMENTS}
        return {"step": torch.zeros((), device=parameter.device), **moments}
