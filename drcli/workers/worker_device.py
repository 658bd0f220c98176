"""Where a worker computes cameras and policy: on a GPU, or on the processor."""

from dataclasses import dataclass
from importlib.util import find_spec

import torch

INSTALL = "pip install 'drcli[gpu]'"


@dataclass(frozen=True)
class WorkerDevice:
    """The choice; `is_wanted`: it is what DR_WORKER_DEVICE asks for."""

    gpu: torch.device | None
    reason: str
    is_wanted: bool = True


def choose_worker_device(wanted: str, worker: int) -> WorkerDevice:
    """By DR_WORKER_DEVICE; several GPUs are given out in turn."""
    if wanted == "cpu":
        return WorkerDevice(None, "on the processor, as set")
    if not torch.cuda.is_available():
        why = "PyTorch finds no GPU"
        return WorkerDevice(None, f"on the processor: {why}", is_wanted=wanted == "auto")
    if find_spec("numba_cuda") is None:
        why = f"drawing on a GPU needs the package numba-cuda ({INSTALL})"
        return WorkerDevice(None, f"on the processor: {why}", is_wanted=wanted == "auto")
    number = worker % torch.cuda.device_count()
    torch.cuda.set_device(number)
    return WorkerDevice(torch.device("cuda", number), f"on {torch.cuda.get_device_name(number)}")
