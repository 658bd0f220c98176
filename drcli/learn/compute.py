"""Where and in which number format the learner computes: a rule, no trial."""

import contextlib
import os
from dataclasses import dataclass, replace

import torch

from drcli.learn.data_parallel import parts_of

FORMATS = ("fp32", "bf16")

_LIMITS = ("ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA")
"""Variables by which oneDNN is held to lesser instructions."""

FEWEST_SAMPLES = 32
"""Samples of a part from which on bfloat16 is worth its casts: on one core with AMX it computes
1.45 to 2.05 times as many samples/s of the four networks with 64 samples, the compact one 1.03
times as many with 16."""

_EAGER = "not compiled: torch.compile reached 0.8 to 1.0 of this speed where it was measured"
"""On two cores, in fp32, both bodies; and compiling took half a minute to more than one."""


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

    @property
    def number_format(self) -> str:
        """One of `FORMATS`."""
        return FORMATS[self.bf16]

    def autocast(self) -> contextlib.AbstractContextManager[None]:
        """The context that a forward pass runs in.

        PyTorch keeps cast weights for the passes of all threads together and forgets them when any
        of them ends one: whether two uses of a weight share a cast, and so where their gradients
        are rounded, would depend on the time.
        """
        return torch.autocast(
            self.device.type, dtype=torch.bfloat16, enabled=self.bf16, cache_enabled=False
        )


def flush_denormals() -> None:
    """Let this thread, and those it starts, take numbers next to 0 for 0.

    Arithmetic with them is far slower, and no gradient needs them. For the main function of a
    process only: all code in the process is affected.
    """
    torch.set_flush_denormal(True)


def choose_compute(
    wanted: str, batch_size: int, threads: int, before: str | None = None
) -> Compute:
    """Pick device and number format for this machine, by a rule: equal seeds train equally.

    bfloat16 is for processors that multiply matrices of it (AMX). Where they have instructions for
    vectors of it only (AVX512_BF16) it computes 0.64 to 0.91 times as many samples/s as float32,
    and without these 0.32 to 0.43 times as many. On a GPU, float32 uses the tensor cores for
    convolutions already.

    Args:
        wanted: "fp32" or "bf16" to insist, "auto" for the rule.
        batch_size: Steps in a minibatch.
        threads: Processor cores to use.
        before: The format that the training began with, if it goes on: "auto" keeps it.
    """
    torch.set_num_threads(threads)
    if torch.cuda.is_available():
        base = Compute(torch.device("cuda"), False, "")
        where = torch.cuda.get_device_name()
        units = False
    else:
        parts = parts_of(batch_size, threads)
        base = Compute(torch.device("cpu"), False, "", threads, parts)
        where = f"{threads} threads, which compute {parts} parts of a minibatch side by side"
        units = has_bfloat16_units()
    usual = "bf16" if units and batch_size // base.parts >= FEWEST_SAMPLES else "fp32"
    name = wanted if wanted in FORMATS else before if before in FORMATS else usual
    if wanted in FORMATS:
        why = "as set"
    elif name != usual:
        why = f"kept from the start of this training ({usual} is faster here: DR_TORCH_PRECISION)"
    elif units:
        why = "this processor has matrix units for bfloat16 (AMX)"
        why += "" if usual == "bf16" else ", but the parts are small"
    else:
        why = "no matrix units for bfloat16 (AMX) here"
    reason = f"{name} on {where}: {why}; minibatches of {batch_size}, {_EAGER}"
    return replace(base, bf16=name == "bf16", reason=reason)


def has_bfloat16_units() -> bool:
    """Whether PyTorch's kernels multiply matrices of bfloat16 in units of their own.

    ONEDNN_MAX_CPU_ISA, which limits the instructions that they use, is obeyed.
    """
    limit = next((os.environ[name] for name in _LIMITS if os.environ.get(name)), "DEFAULT")
    allowed = limit.upper() in ("DEFAULT", "ALL") or "AMX" in limit.upper()
    return allowed and bool(torch.cpu.get_capabilities().get("amx_bf16", False))
