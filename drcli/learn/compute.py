"""Chooses device and number format of the learner by a fixed rule."""

import contextlib
import os
from dataclasses import dataclass

import torch

from drcli.learn.data_parallel import parts_of

FORMATS = ("fp32", "bf16")

_LIMITS = ("ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA")
"""Variables that limit the instructions that oneDNN uses."""

FEWEST_SAMPLES = 32
"""Samples of a part from which on bfloat16 is worth its casts. On one core with AMX it computes
1.45 to 2.05 times as many samples/s with 64 samples (four networks), but only 1.03 times as many
with 16 (the compact one)."""

_EAGER = "not compiled: torch.compile reached 0.8 to 1.0 of this speed where it was measured"
"""On two cores, in fp32, both bodies; compiling took half a minute to more than one."""


@dataclass(frozen=True)
class Compute:
    """Device and number format of an update.

    Attributes:
        device: "cpu" or "cuda".
        bf16: Whether convolutions and matrix products run in bfloat16. Weights, optimizer and
            losses stay in float32.
        reason: Why, for the log.
        threads: Processor cores of an update; unused on a GPU.
        parts: Number of parts of a minibatch; see `DataParallel`.
    """

    device: torch.device
    bf16: bool
    reason: str
    threads: int = 1
    parts: int = 1

    @property
    def number_format(self) -> str:
        """One of `FORMATS`."""
        return FORMATS[self.bf16]

    def autocast(self) -> contextlib.AbstractContextManager[None]:
        """The context of a forward pass.

        Its cache of cast weights is off. All threads share that cache, and it is cleared when any
        thread ends a pass. So timing would decide whether two uses of a weight share a cast, and
        how their gradients are rounded.
        """
        return torch.autocast(
            self.device.type, dtype=torch.bfloat16, enabled=self.bf16, cache_enabled=False
        )


def flush_denormals() -> None:
    """Let this thread, and those that it starts, treat numbers next to 0 as 0.

    Arithmetic with them is far slower, and no gradient needs them. Call this only in the main
    function of a process, because it affects all code.
    """
    torch.set_flush_denormal(True)


def choose_compute(
    wanted: str, batch_size: int, threads: int, before: str | None = None
) -> Compute:
    """Choose device and number format by a rule, so that equal seeds train equally.

    bfloat16 is for processors with matrix units for it (AMX). With vector instructions only
    (AVX512_BF16) it computes 0.64 to 0.91 times as many samples/s as float32, and without these
    0.32 to 0.43 times as many. On a GPU, float32 already uses the tensor cores for convolutions.

    Args:
        wanted: "fp32", "bf16", or "auto" for the rule.
        batch_size: Steps in a minibatch.
        threads: Processor cores to use.
        before: The format that a resumed training began with; "auto" keeps it.
    """
    torch.set_num_threads(threads)
    if torch.cuda.is_available():
        device, parts, units = "cuda", 1, False
        where = torch.cuda.get_device_name()
    else:
        device, parts, units = "cpu", parts_of(batch_size, threads), has_bfloat16_units()
        where = f"{threads} threads, which compute {parts} parts of a minibatch at a time"
    usual = "bf16" if units and batch_size // parts >= FEWEST_SAMPLES else "fp32"
    name = wanted if wanted in FORMATS else before if before in FORMATS else usual
    if wanted in FORMATS:
        why = "as set"
    elif name != usual:
        why = f"kept from the start of this training ({usual} is faster here: DR_TORCH_PRECISION)"
    elif device == "cuda":
        why = "convolutions use its tensor cores anyway"
    elif units:
        why = "this processor has matrix units for bfloat16 (AMX)"
        why += "" if usual == "bf16" else ", but the parts are small"
    else:
        why = "no matrix units for bfloat16 (AMX) here"
    reason = f"{name} on {where}: {why}; minibatches of {batch_size}, {_EAGER}"
    return Compute(torch.device(device), name == "bf16", reason, threads, parts)


def has_bfloat16_units() -> bool:
    """Whether PyTorch can use matrix units for bfloat16, as far as ONEDNN_MAX_CPU_ISA allows it."""
    limit = next((os.environ[name] for name in _LIMITS if os.environ.get(name)), "DEFAULT")
    allowed = limit.upper() in ("DEFAULT", "ALL") or "AMX" in limit.upper()
    return allowed and bool(torch.cpu.get_capabilities().get("amx_bf16", False))
