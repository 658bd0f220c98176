"""The machine against rule V-50: room on the disk, in memory and on the GPU."""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import psutil

from drcli.config import Settings
from drcli.hyperparameters import Hyperparameters
from drcli.model_metadata import ModelMetadata
from drcli.validate.report import Violation

LEAST_DISK_BYTES = 2_000_000_000
"""Five checkpoints of the largest network with their optimizer states, and logs."""

WORKER_BYTES = 600_000_000
"""Memory of a simulation worker, measured."""

TRAINER_BYTES = 900_000_000
"""Memory of the trainer with the common networks, measured."""

FRAME_BYTES = 19_200
"""A picture of 160 x 120 grey pixels in the replay of sac."""

LEAST_GPU_BYTES = 1_500_000_000
"""Memory that learning takes on a GPU, its library included."""

GPU_PATIENCE_S = 3.0


def review_disk(settings: Settings, directory: Path) -> Iterator[Violation]:
    """Room for models (where this machine keeps the bucket) and for logs."""
    folders = {directory}
    if settings.cloud == "local":
        folders.add(directory / settings.s3_data_dir)
    said: set[int] = set()
    for folder in sorted(folders):
        place = next(place for place in (folder, *folder.parents) if place.exists())
        free = shutil.disk_usage(place).free
        if free < LEAST_DISK_BYTES and free not in said:
            said.add(free)
            yield Violation(
                "V-50",
                "warning",
                str(place),
                f"Only {_shown(free)} of the disk are free, and a training may need "
                f"{_shown(LEAST_DISK_BYTES)}.",
                "Delete models or logs that you no longer need, or set DR_S3_DATA_DIR to a folder "
                "on another disk.",
            )


def review_memory(
    settings: Settings, parameters: Hyperparameters | None, metadata: ModelMetadata | None
) -> Iterator[Violation]:
    """Room for all processes of the training."""
    needed = settings.workers * WORKER_BYTES + TRAINER_BYTES
    if parameters is not None and metadata is not None and metadata.training_algorithm == "sac":
        needed += parameters.sac_replay_steps * FRAME_BYTES * metadata.eyes
    free = psutil.virtual_memory().available
    if free < needed:
        yield Violation(
            "V-50",
            "warning",
            settings.source("DR_WORKERS"),
            f"{_shown(free)} of memory are free, and a trainer with {settings.workers} simulation "
            f"workers may need {_shown(needed)}.",
            "End other programs, or lower DR_WORKERS (or sac_replay_steps).",
        )


def review_gpu() -> Iterator[Violation]:
    """Room on one of the GPUs, where there are any."""
    program = shutil.which("nvidia-smi")
    if program is None:
        return
    query = [program, "--query-gpu=memory.free", "--format=csv,noheader,nounits"]
    try:
        done = subprocess.run(
            query, capture_output=True, text=True, timeout=GPU_PATIENCE_S, check=False
        )
        free = [int(line) * 2**20 for line in done.stdout.split()]
    except (OSError, subprocess.TimeoutExpired, ValueError):
        return  # no working GPU: the processor learns
    if free and max(free) < LEAST_GPU_BYTES:
        yield Violation(
            "V-50",
            "warning",
            "nvidia-smi",
            f"Only {_shown(max(free))} of GPU memory are free, and learning may need "
            f"{_shown(LEAST_GPU_BYTES)}.",
            "End other programs on the GPU, or hide it with CUDA_VISIBLE_DEVICES=-1.",
        )


def _shown(size_bytes: int) -> str:
    return f"{size_bytes / 1e9:.1f} GB"
