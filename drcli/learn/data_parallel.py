"""Computes gradients and actions of one batch in parts, each in its own thread.

Threads inside operations wait for each other hundreds of times per gradient step, these once.
"""

import copy
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from itertools import pairwise
from threading import Barrier
from typing import Generic, TypeVar

import torch
from torch import Tensor, distributed, nn

from drcli.learn.encoders import compute_in
from drcli.learn.policy import Observation, Policy
from drcli.learn.update_result import NonFiniteLossError

# Sums gradients over several learner processes with the same weights, by torch.distributed.
#
# Every process calls the same methods in the same order.


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


SMALLEST_PART = 16
"""Fewer samples take more time each."""

FEWEST_CARS = 4
LARGE = 2_000_000
"""Parameters for which threads pay: 5.8 million gain 1.03 times the samples/s, 0.6 million lose a
tenth while another program is busy.
"""

M = TypeVar("M", bound=nn.Module)

LossOf = Callable[[M, slice], tuple[Tensor, Tensor]]
"""Mean loss and means of statistics of some samples; called in several threads."""


def parts_of(batch_size: int, threads: int) -> int:
    """A fixed rule, so that equal seeds train equally."""
    return max(1, min(threads, batch_size // SMALLEST_PART))


class DataParallel(Generic[M]):
    """Takes the gradient of a minibatch in parts, with copies of the network on the same weights.

    On two cores 1.07 times as fast as threads inside operations, 1.5 times beside a busy program.

    Attributes:
        most_samples: At once; halved when a GPU's memory is too small. None: all of a part.
    """

    def __init__(
        self,
        model: M,
        parts: int = 1,
        threads: int = 1,
        *,
        bf16: bool = False,
        group: GradientGroup | None = None,
        num_statistics: int = 0,
    ) -> None:
        """Start a thread for each part; a GPU has one.

        With `bf16`, all parts share one cast of the weights: casting in every layer took a third
        of the time (torch.autocast, AMD EPYC with AVX512_BF16).
        """
        self._model = model
        self._group = group
        self._num_statistics = num_statistics
        self._parameters = list(model.parameters())
        self._models = [model]
        if bf16:
            self._models = [_copy_on_same_weights(model)]
            compute_in(self._models[0], torch.bfloat16)
        self._casts = [
            (own, cast)
            for own, cast in zip(self._parameters, self._models[0].parameters(), strict=True)
            if own.dtype is not cast.dtype
        ]
        self.most_samples: int | None = None
        self._part_threads = max(1, threads // parts)
        self._is_large = sum(p.numel() for p in model.parameters()) > LARGE
        self._pool: ThreadPoolExecutor | None = None
        if parts == 1:
            return
        self._models += [_copy_on_same_weights(self._models[0]) for _ in range(parts - 1)]
        before = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(parts, "minibatch")
        together = Barrier(parts)
        wait([self._pool.submit(_begin_thread, self._part_threads, together) for _ in range(parts)])
        torch.set_num_threads(before)

    @contextmanager
    def optimizer_threads(self) -> Iterator[None]:
        """With as many threads as suit the optimizer."""
        before = torch.get_num_threads()
        if self._pool is not None and not self._is_large:
            torch.set_num_threads(self._part_threads)
        try:
            yield
        finally:
            torch.set_num_threads(before)

    def backward(self, loss_of: LossOf[M], samples: int) -> Tensor:
        """Add the gradient of the mean loss to the parameters'; return means of the statistics.

        Sums have a fixed order, so that equal seeds give equal weights. All of a group call this
        with the same minibatch.

        Raises:
            torch.OutOfMemoryError: Even a single sample is too large.
            NonFiniteLossError: `loss_of` raised it, here or in another process.
            LearnerLostError: Another process has ended.
        """
        own, weight = slice(0, samples), 1.0
        if self._group is not None:
            own, weight = self._group.own_share(samples)
        return self._backward_with_others(loss_of, own, weight)

    def backward_share(self, loss_of: LossOf[M], samples: int, weight: float) -> Tensor:
        """The same with this process's own minibatch; the weights of all processes sum to 1."""
        return self._backward_with_others(loss_of, slice(0, samples), weight)

    def _backward_with_others(self, loss_of: LossOf[M], own: slice, weight: float) -> Tensor:
        if self._group is None:
            return self._backward_of(loss_of, own, weight)
        learned = [p for p in self._parameters if p.requires_grad]
        failure = None
        try:
            statistics = self._backward_of(loss_of, own, weight)
        except NonFiniteLossError as error:
            failure, statistics = error, learned[0].new_zeros(self._num_statistics)
        return self._group.add_up(learned, statistics, failure)

    def _backward_of(self, loss_of: LossOf[M], samples: slice, weight: float) -> Tensor:
        own, length = self._parameters, samples.stop - samples.start
        before = [None if p.grad is None else p.grad.clone() for p in own]
        while True:
            try:
                return self._backward_once(loss_of, samples, weight)
            except torch.OutOfMemoryError:
                if self.most_samples == 1:
                    raise
                failed = min(length, self.most_samples or length)
            # Outside of `except`: the exception holds on to the tensors of the failed pass.
            self.most_samples = max(1, failed // 2)
            for parameter, grad in zip(own, before, strict=True):
                # Without what the first parts have left.
                parameter.grad = None if grad is None else grad.clone()
            if torch.cuda.is_available():
                torch.cuda.empty_cache()

    def _backward_once(self, loss_of: LossOf[M], samples: slice, weight: float) -> Tensor:
        length = samples.stop - samples.start

        def backward(model: M, part: slice) -> Tensor:
            shifted = slice(samples.start + part.start, samples.start + part.stop)
            return _backward(model, loss_of, shifted, (length, weight), most)

        with torch.no_grad():
            for own, cast in self._casts:
                cast.copy_(own)
        models, most = self._models, self.most_samples
        for model in models:
            if model is not self._model:
                model.zero_grad(set_to_none=True)  # what a failed call may have left
        if self._pool is None or length < len(models):
            models = models[:1]
            statistics = backward(models[0], slice(0, length))
        else:
            parts = _parts(length, len(models))
            tasks = [
                self._pool.submit(backward, model, part)
                for model, part in zip(models, parts, strict=True)
            ]
            wait(tasks)
            statistics = torch.stack([task.result() for task in tasks]).sum(0)
        self._add_up(models)
        return statistics

    @torch.no_grad()
    def _add_up(self, models: list[M]) -> None:
        for own, *parts in zip(self._parameters, *(m.parameters() for m in models), strict=True):
            grads = [part.grad for part in parts if part is not own and part.grad is not None]
            for part in parts:
                part.grad = part.grad if part is own else None
            if own.grad is not None:
                grads.insert(0, own.grad)
            if grads:
                # In the format of the parts, as torch's own data parallel training does it.
                total = grads[0]
                for grad in grads[1:]:
                    total.add_(grad)
                own.grad = total.to(own.dtype)


class DataParallelPolicy:
    """A policy that chooses for parts of the cars at the same time.

    Threads inside operations are half as fast beside a busy program: call
    `torch.set_num_threads(1)`.
    """

    def __init__(self, policy: Policy, threads: int) -> None:
        """Start the threads; for a policy on the CPU."""
        self.policy, self.spec = policy, policy.spec
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads, "policy") if threads > 1 else None

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        count = min(self._threads, len(noise) // FEWEST_CARS)
        if self._pool is None or count < 2:
            return self.policy.act(seen, noise, deterministic, epsilon)

        def act(cars: slice) -> tuple[Tensor, Tensor, Tensor]:
            with torch.inference_mode():  # counts for one thread only
                return self.policy.act(seen.part(cars), noise[cars], deterministic[cars], epsilon)

        chosen = self._pool.map(act, _parts(len(noise), count))
        actions, log_probs, values = zip(*chosen, strict=True)
        return torch.cat(actions), torch.cat(log_probs), torch.cat(values)


def _parts(length: int, count: int) -> list[slice]:
    return [slice(*ends) for ends in pairwise(length * i // count for i in range(count + 1))]


def _backward(
    model: M, loss_of: LossOf[M], part: slice, whole: tuple[int, float], most: int | None
) -> Tensor:
    samples, weight = whole
    length = part.stop - part.start
    total: Tensor | None = None
    for each in _parts(length, -(-length // (most or length))):
        own = slice(part.start + each.start, part.start + each.stop)
        share = (own.stop - own.start) / samples * weight
        loss, statistics = loss_of(model, own)
        torch.autograd.backward(loss * share)
        weighted = statistics.detach() * share
        total = weighted if total is None else total + weighted
        del loss, statistics
    if total is None:
        raise ValueError("a part has no samples")
    return total


def _copy_on_same_weights(model: M) -> M:
    twin = copy.deepcopy(model)
    shared = (*model.parameters(), *model.buffers())
    for own, other in zip((*twin.parameters(), *twin.buffers()), shared, strict=True):
        own.data = other.data
    return twin


def _begin_thread(threads: int, together: Barrier) -> None:
    torch.set_num_threads(threads)
    torch.get_num_threads()  # makes the limit permanent in this thread
    together.wait()
