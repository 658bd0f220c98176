"""Where and in which number format the learner computes, chosen by trying."""

import contextlib
import time
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from drcli.learn.crew import Crew, parts_of
from drcli.learn.observation import Observation
from drcli.learn.policy import ActorCritic
from drcli.learn.spec import FRAME_HEIGHT, FRAME_WIDTH, PolicySpec

TRIALS, TRIAL_S = 3, 0.1
"""How often each format is tried, in turns, and how long, seconds. The best of each counts: other
programs slow a machine down for a while."""

WORTH = 1.1
"""How many times as fast bfloat16 must be: it costs digits, and memory where it is emulated."""

_EAGER = "not compiled: torch.compile reached 0.8 to 1.0 of this speed where it was measured"
"""On two cores, in fp32, both bodies; and compiling took half a minute to more than one."""

GLANCE_SAMPLES = 4
GLANCE_RATIO = 0.5
"""A first glance at a few samples: bfloat16 that is slower than this share is not tried further."""


@dataclass(frozen=True)
class Compute:
    """Device and number format of an update.

    Attributes:
        device: "cpu" or "cuda".
        bf16: Whether convolutions and matrix products run in bfloat16. Weights, optimizer and
            losses stay in float32.
        reason: Why, in words for the log.
        threads: Processor cores of an update; they count on a processor only.
        parts: Into how many parts they divide a minibatch.
    """

    device: torch.device
    bf16: bool
    reason: str
    threads: int = 1
    parts: int = 1

    def autocast(self) -> contextlib.AbstractContextManager[None]:
        """The context that a forward pass runs in."""
        return torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.bf16)


def flush_denormals() -> None:
    """Let this thread, and those it starts, take numbers next to 0 for 0.

    Arithmetic with them is far slower, and no gradient needs them. For the main function of a
    process only: all code in the process is affected.
    """
    torch.set_flush_denormal(True)


def choose_compute(wanted: str, spec: PolicySpec, batch_size: int, threads: int) -> Compute:
    """Pick device and number format for this machine.

    Args:
        wanted: "fp32" or "bf16" to insist, "auto" to time both and keep the faster.
        spec: The network to be trained.
        batch_size: Steps in a minibatch.
        threads: Processor cores to use.
    """
    torch.set_num_threads(threads)
    if torch.cuda.is_available():
        base = Compute(torch.device("cuda"), False, "")
        where = torch.cuda.get_device_name()
    else:
        parts = parts_of(batch_size, threads)
        base = Compute(torch.device("cpu"), False, "", threads, parts)
        where = f"{threads} threads, which compute {parts} parts of a minibatch side by side"
    if wanted != "auto":
        reason = f"{wanted} on {where}, as set; minibatches of {batch_size}, {_EAGER}"
        return replace(base, bf16=wanted == "bf16", reason=reason)

    # Without bfloat16 units a whole minibatch takes seconds; a few samples show that much sooner.
    speeds = {}
    for samples, trials, seconds in ((GLANCE_SAMPLES, 1, 0.0), (batch_size, TRIALS, TRIAL_S)):
        speeds = {False: 0.0, True: 0.0}
        for _ in range(trials):
            for bf16 in speeds:
                speed = _samples_per_s(replace(base, bf16=bf16), spec, samples, seconds)
                speeds[bf16] = max(speeds[bf16], speed)
        if speeds[True] < GLANCE_RATIO * speeds[False]:
            break
    faster = speeds[True] > WORTH * speeds[False]
    reason = (
        f"{'bf16' if faster else 'fp32'} on {where}: "
        f"{speeds[False]:.0f} samples/s in fp32, {speeds[True]:.0f} in bf16; minibatches of "
        f"{batch_size}, {_EAGER}"
    )
    return replace(base, bf16=faster, reason=reason)


def _samples_per_s(compute: Compute, spec: PolicySpec, batch_size: int, seconds: float) -> float:
    """Forward and backward passes of a throw-away network, timed for so long, at least once."""
    crew = Crew(ActorCritic(spec).to(compute.device), compute.parts, compute.threads)
    shape = (batch_size, spec.channels, FRAME_HEIGHT, FRAME_WIDTH)
    seen = Observation(
        torch.zeros(shape, dtype=torch.uint8, device=compute.device),
        torch.zeros((batch_size, spec.scan_dims), device=compute.device),
        torch.zeros((batch_size, spec.state_dims), device=compute.device),
    )

    def loss_of(model: ActorCritic, part: slice) -> tuple[Tensor, Tensor]:
        with compute.autocast():
            policy, value = model(Observation(*(column[part] for column in seen)))
        loss = policy.square().mean() + value.square().mean()
        return loss, loss

    def once() -> None:
        crew.step(loss_of, batch_size, lambda: None)
        if compute.device.type == "cuda":
            torch.cuda.synchronize()

    once()
    start, count = time.perf_counter(), 0
    while (elapsed := time.perf_counter() - start) < seconds or count == 0:
        once()
        count += 1
    return count * batch_size / elapsed
