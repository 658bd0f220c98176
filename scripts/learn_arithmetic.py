"""Arithmetic per second of an update and of `torch.mm`, for bench_learn.py."""

import time
from dataclasses import replace

import torch
from learn_runs import Work, beginning

from drcli.learn.actor_critic import ActorCritic, flops_per_sample
from drcli.learn.ppo import PPO
from drcli.learn.rollout_buffer import Rollout

SIZES = (512, 1024, 2048, 4096)
STEPS = 1_024
PRODUCT_S = 0.1
"""How long the product of each size is repeated, at least once."""

EMULATED_SIZES = (128, 256, 512)
EMULATED_STEPS = 16
"""Where a number format is emulated, a minibatch takes many seconds."""

EMULATED_RATIO = 0.3
"""A format whose products reach less than this share of float32's is emulated."""


class Arithmetic:
    """Our update and `torch.mm` in one number format.

    Attributes:
        emulated: Whether the format is far slower than float32, so that little of it is done.
    """

    def __init__(self, work: Work, rollout: Rollout, *, bf16: bool) -> None:
        """Begin.

        Args:
            work: The network and its update.
            rollout: What to learn from, again and again.
            bf16: Compute in bfloat16, else in float32.
        """
        self._device = work.compute.device
        self._format = torch.bfloat16 if bf16 else torch.float32
        small = EMULATED_SIZES[1]
        self.emulated = bf16 and (
            self._product_flops(small, self._format)
            < EMULATED_RATIO * self._product_flops(small, torch.float32)
        )
        config = replace(work.config, num_epochs=1) if self.emulated else work.config
        self._rollout = beginning(rollout, EMULATED_STEPS if self.emulated else STEPS)
        self._sizes = EMULATED_SIZES if self.emulated else SIZES
        self._ppo = PPO(ActorCritic(work.spec), config, replace(work.compute, bf16=bf16))
        batch_size = min(config.batch_size, self._rollout.steps)
        batches = config.num_epochs * (self._rollout.steps // batch_size)
        self._flops = batches * batch_size * flops_per_sample(work.spec, backward=True)

    def update(self) -> float:
        """FLOP/s of a whole update: everything it does takes time, only the layers count."""
        started_s = time.perf_counter()
        self._ppo.update(self._rollout, seed=0)
        return self._flops / (time.perf_counter() - started_s)

    def product(self) -> float:
        """FLOP/s of `torch.mm`, the best of several sizes."""
        return max(self._product_flops(size, self._format) for size in self._sizes)

    def _product_flops(self, size: int, number_format: torch.dtype) -> float:
        a = torch.rand((size, size), device=self._device).to(number_format)
        out = torch.mm(a, a)
        self._wait()
        started_s, count = time.perf_counter(), 0
        while (spent_s := time.perf_counter() - started_s) < PRODUCT_S or count == 0:
            torch.mm(a, a, out=out)
            self._wait()
            count += 1
        return 2.0 * size**3 * count / spent_s

    def _wait(self) -> None:
        if self._device.type == "cuda":
            torch.cuda.synchronize()
