"""The optimizer, with a memory that can be stored as named tensors."""

from collections.abc import Iterable

import torch
from torch import Tensor
from torch.optim.adam import adam

MOMENTS = ("exp_avg", "exp_avg_sq")
BETAS = (0.9, 0.999)


class Adam:
    """Adam (Kingma and Ba, 2015, algorithm 1) by PyTorch's functional form, fused.

    The class `torch.optim.Adam` loads PyTorch's compiler, used or not: 70 MB and more than a
    second of every process that learns.

    Attributes:
        lr: Step size of the next steps.
    """

    def __init__(self, parameters: Iterable[Tensor], lr: float, eps: float = 1e-8) -> None:
        self.lr = lr
        self._parameters = list(parameters)
        self._eps = eps
        self._memory: dict[int, dict[str, Tensor]] = {}

    def zero_grad(self) -> None:
        """Forget the gradients of all parameters."""
        for parameter in self._parameters:
            parameter.grad = None

    @torch.no_grad()
    def step(self) -> None:
        """Act on the gradients of all parameters that have one."""
        due = [i for i, p in enumerate(self._parameters) if p.grad is not None]
        for index in due:
            if index not in self._memory:
                self._memory[index] = self._first_memory(self._parameters[index])
        column = {name: [self._memory[i][name] for i in due] for name in ("step", *MOMENTS)}
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
            lr=self.lr,
            weight_decay=0.0,
            eps=self._eps,
            maximize=False,
        )

    def tensors(self) -> dict[str, Tensor]:
        """Everything it remembers, as `torch.optim.Adam` names it.

        These are the tensors it goes on with, no copies: store them before the next step.

        Returns:
            Tensors by "<index of the parameter>.<name>"; empty before the first step.
        """
        return {
            f"{index}.{name}": value.contiguous()
            for index, memory in self._memory.items()
            for name, value in memory.items()
        }

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take up the memory of another one over equal parameters; the tensors are copied.

        Each comes to lie in memory as its parameter does: the fused arithmetic goes through both
        without a look at their strides, and stored tensors have lost theirs.

        Args:
            tensors: As `tensors` returns them.

        Raises:
            ValueError: They belong to other parameters; nothing was taken up.
        """
        memory: dict[int, dict[str, Tensor]] = {}
        indices = {str(index): index for index in range(len(self._parameters))}
        for key, value in tensors.items():
            text, _, name = key.partition(".")
            if text not in indices or name not in ("step", *MOMENTS):
                raise ValueError(f"An optimizer of {len(indices)} parameters has no {key}.")
            index = indices[text]
            if index not in memory:
                memory[index] = self._first_memory(self._parameters[index])
            own = memory[index][name]
            if own.shape != value.shape:
                raise ValueError(
                    f"{key} is of shape {tuple(value.shape)}, its parameter wants "
                    f"{tuple(own.shape)}."
                )
            own.copy_(value)
        self._memory = memory

    @staticmethod
    def _first_memory(parameter: Tensor) -> dict[str, Tensor]:
        moments = {name: torch.zeros_like(parameter.detach()) for name in MOMENTS}
        return {"step": torch.zeros((), device=parameter.device), **moments}
