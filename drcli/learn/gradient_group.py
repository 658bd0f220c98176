"""Sums gradients over several learner processes with the same weights, by torch.distributed.

Every process calls the same methods in the same order.
"""

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor, distributed

from drcli.learn.update_result import NonFiniteLossError


class LearnerLostError(RuntimeError):
    """Another learner process has ended."""


class GradientGroup:
    """The learner processes of a training, seen from one of them.

    torch's DistributedDataParallel cannot repeat a minibatch that did not fit into a GPU.

    Attributes:
        rank: 0 is the trainer.
        slots: Shared memory; None if gradients are sent.
    """

    def __init__(self) -> None:
        self.rank: int = distributed.get_rank()
        self.size: int = distributed.get_world_size()
        self.slots: Tensor | None = None
        self._sums = torch.empty(0)
        self._turn = 0

    def own_share(self, samples: int) -> tuple[slice, float]:
        """This process's samples, and their weight; all samples if there are too few."""
        if samples < self.size:
            return slice(0, samples), 1.0 / self.size
        ends = [samples * rank // self.size for rank in (self.rank, self.rank + 1)]
        return slice(*ends), (ends[1] - ends[0]) / samples

    def add_up(
        self, parameters: Sequence[Tensor], statistics: Tensor, failure: NonFiniteLossError | None
    ) -> Tensor:
        """Sum gradients, in place, and statistics over all processes.

        Raises:
            NonFiniteLossError: A process had a `failure`; all raise it.
            LearnerLostError: Another process has ended.
        """
        failed = statistics.new_tensor([float(failure is not None)])
        numbers = torch.cat([statistics.flatten(), failed])
        if self.slots is None:
            joined = torch.cat([*_grads(parameters), numbers])
            if failure is not None:
                joined[:-1] = 0.0
            self.sum(joined)  # one message, because each one takes as long as some layers
            sums, numbers = joined[: -len(numbers)], joined[-len(numbers) :]
        else:
            slots, self._turn = self.slots[self._turn], 1 - self._turn
            torch.cat(_grads(parameters), out=slots[self.rank])
            # Nobody gets an answer before all have written. Who writes into these slots again, two
            # steps later, has an answer for the step in between: everybody has read them.
            self.sum(numbers)
            # In the order of the processes, so that all get the same bits.
            sums = torch.add(slots[0], slots[1], out=self._sums)
            for slot in slots[2:]:
                sums.add_(slot)
        if numbers[-1] > 0.0:
            raise failure or NonFiniteLossError(
                "The loss of another learner process is not finite."
            )
        at = 0
        for parameter in parameters:
            total = sums[at : at + parameter.numel()].view(parameter.shape)
            at += parameter.numel()
            if parameter.grad is None:
                continue
            if parameter.is_contiguous():
                parameter.grad = total
            else:
                parameter.grad.copy_(total)  # in the layout of the weights, as Adam needs it
        return numbers[:-1].view(statistics.shape)

    def share_memory(self, slots: Tensor | None) -> None:
        """Exchange gradients through shared `slots`; None to send them. Shape (2, size, n)."""
        self.slots = slots
        self._sums = torch.empty(0 if slots is None else slots.shape[2])

    def of_all(self, number: int) -> list[int]:
        numbers = torch.zeros(self.size, dtype=torch.int64)
        numbers[self.rank] = number
        self.sum(numbers)
        return [int(each) for each in numbers]

    def sum(self, tensor: Tensor) -> None:
        try:
            distributed.all_reduce(tensor)
        except RuntimeError as error:
            raise LearnerLostError(_first_line(error)) from error

    def from_trainer(self, tensors: Iterable[Tensor]) -> None:
        try:
            for tensor in tensors:
                if tensor.numel():
                    distributed.broadcast(tensor, src=0)
        except RuntimeError as error:
            raise LearnerLostError(_first_line(error)) from error


def _grads(parameters: Sequence[Tensor]) -> list[Tensor]:
    return [(torch.zeros_like(p) if p.grad is None else p.grad).flatten() for p in parameters]


def _first_line(error: RuntimeError) -> str:
    return (str(error).splitlines() or [""])[0]
