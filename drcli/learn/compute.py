"""Chooses device and number format of the learner by a fixed rule."""

import os
import time
from dataclasses import dataclass

import torch
from torch import nn

from drcli.learn.data_parallel import parts_of

FORMATS = ("fp32", "bf16")

_LIMITS = ("ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA")
_EAGER = "not compiled: torch.compile reached 0.8 to 1.0 of this speed where it was measured"
"""Two cores, fp32, both bodies; compiling took half a minute or more."""


_GRAPHS = "each step as one CUDA graph"


@dataclass(frozen=True)
class Compute:
    """Device and number format of an update.

    `bf16` is for convolutions and matrix products; the rest stays in float32.
    """

    device: torch.device
    bf16: bool
    reason: str
    threads: int = 1
    parts: int = 1
    graphs: bool = False
    warning: str = ""

    @property
    def number_format(self) -> str:
        return FORMATS[self.bf16]


def gpu_count() -> int:
    return torch.cuda.device_count() if torch.cuda.is_available() else 0


def flush_denormals() -> None:
    """Let this thread and those that it starts round numbers next to 0 to 0, which is faster.

    Only for main functions: it affects all code.
    """
    torch.set_flush_denormal(True)


def choose_compute(
    wanted: str, batch_size: int, threads: int, before: str | None = None
) -> Compute:
    """Choose device and number format by a rule, so that equal seeds train equally.

    bfloat16 is 1.1 to 1.9 times as fast as float32 with AMX or AVX512_BF16, and 1.4 to 2.3 times
    on an NVIDIA H200 (`scripts/bench gpu`). Elsewhere it is emulated, several times slower.
    """
    torch.set_num_threads(threads)
    if torch.cuda.is_available():
        has_it = torch.cuda.is_bf16_supported(including_emulation=False)
        device, parts, units = "cuda", 1, "tensor cores" if has_it else ""
        where = torch.cuda.get_device_name()
    else:
        device, parts, units = "cpu", parts_of(batch_size, threads), bfloat16_units()
        where = f"{threads} threads, which compute {parts} parts of a minibatch at a time"
        if parts == 1:
            where = f"{threads} thread" + "s" * (threads != 1)
    usual = "bf16" if units else "fp32"
    name = wanted if wanted in FORMATS else before if before in FORMATS else usual
    warning = ""
    if name == "bf16" and not units:
        times = bf16_slowdown(device)
        slow = f"bf16 takes {times:.1f} times as long as fp32 here (convolutions, measured now)"
        if wanted == "bf16":
            warning = f"{slow}. DR_TORCH_PRECISION=bf16 in system.env asks for it; auto does not."
        else:
            name = usual
            warning = (
                f"{slow}, so this training, which began in bf16, goes on in fp32. "
                "DR_TORCH_PRECISION=bf16 in system.env keeps bf16."
            )
    if wanted in FORMATS:
        why = "as set"
    elif warning:
        why = "faster here than bf16, with which this training began"
    elif name != usual:
        why = f"kept from the start of this training ({usual} is faster here: DR_TORCH_PRECISION)"
    elif device == "cuda":
        why = "its tensor cores have bfloat16" if units else "its tensor cores have no bfloat16"
    elif units:
        why = f"this processor has instructions for bfloat16 ({units})"
    else:
        why = "no instructions for bfloat16 (AMX, AVX512_BF16) here"
    graphs = device == "cuda"
    how = _GRAPHS if graphs else _EAGER
    reason = f"{name} on {where}: {why}; minibatches of {batch_size}, {how}"
    return Compute(torch.device(device), name == "bf16", reason, threads, parts, graphs, warning)


def bf16_slowdown(device: str) -> float:
    """How many times as long convolutions take in bfloat16 as in float32, with gradients."""
    # Other programs would change the wall time, which alone can tell how long a GPU works.
    clock = time.perf_counter if device == "cuda" else time.process_time
    seconds = []
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    for number_format in (torch.float32, torch.bfloat16):
        first = nn.Conv2d(1, 32, 8, 4)
        layers = nn.Sequential(first, nn.ReLU(), nn.Conv2d(32, 64, 4, 2)).to(device, number_format)
        frames = torch.zeros(2, 1, 120, 160, dtype=number_format, device=device)
        taken = []
        for _ in range(3):  # the first one takes fresh memory and chooses kernels
            began = clock()
            layers(frames).sum().backward()
            float(first.weight.detach().sum())  # waits for a GPU
            taken.append(clock() - began)
        seconds.append(min(taken))
    torch.set_num_threads(threads)
    return seconds[1] / seconds[0]


def driving_format(learner: str | None) -> torch.dtype:
    """The learner's, because it compares probabilities; float32 where bfloat16 is slow."""
    return torch.bfloat16 if learner == "bf16" and bfloat16_units() else torch.float32


def bfloat16_units() -> str:
    """Either "AMX", "AVX512_BF16" or nothing, as far as ONEDNN_MAX_CPU_ISA allows."""
    limit = next((os.environ[name] for name in _LIMITS if os.environ.get(name)), "DEFAULT").upper()
    known = torch.cpu.get_capabilities()
    anything = limit in ("DEFAULT", "ALL") or "AMX" in limit or "AVX10" in limit
    if anything and known.get("amx_bf16", False):
        return "AMX"
    if (anything or "BF16" in limit or "FP16" in limit) and known.get("avx512_bf16", False):
        return "AVX512_BF16"
    return ""
