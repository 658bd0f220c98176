"""V-50: room on disk, in memory and on the GPU, and who may read files."""

import shutil
import stat
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

import psutil

from drcli.base.errors import Place, Problem, ProblemsError
from drcli.base.files import is_settings, others_may_read, read_regular
from drcli.config.run_config import StorageConfig
from drcli.config.secret_environment import is_secret
from drcli.config.settings_files import parse_env
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata

LEAST_DISK_BYTES = 2_000_000_000
"""Five checkpoints of the largest network with optimizer states, and logs."""

WORKER_BYTES = 600_000_000
"""Measured."""

TRAINER_BYTES = 900_000_000
"""With the common networks, measured."""

FRAME_BYTES = 19_200
"""160 x 120 grey pixels in a replay buffer."""

LEAST_GPU_BYTES = 1_500_000_000
"""Taken by learning and its library."""

GPU_PATIENCE_S = 4.0


def review_disk(storage: StorageConfig, directory: Path) -> Iterator[Problem]:
    folders = {directory}
    if storage.cloud == "local":
        folders.add(storage.data_dir)
    reported: set[int] = set()
    for folder in sorted(folders):
        place = next(place for place in (folder, *folder.parents) if place.exists())
        disk = place.stat().st_dev
        free = shutil.disk_usage(place).free
        if free < LEAST_DISK_BYTES and disk not in reported:
            reported.add(disk)
            needed = _shown(LEAST_DISK_BYTES)
            what = f"only {_shown(free)} of the disk is free; a training may need {needed}."
            remedy = (
                "Delete models or logs that you no longer need, or set DR_S3_DATA_DIR to a folder "
                "on another disk."
            )
            yield Problem("V-50", "warning", str(place), None, what, remedy)


def review_access(storage: StorageConfig, directory: Path) -> Iterator[Problem]:
    """Settings with secrets and what trainings store are private."""
    for path in sorted((*directory.glob("*.env*"), *directory.glob("experiments/*/*.env*"))):
        secrets = _secrets_in(path) if is_settings(path) else []
        if secrets:
            name = str(path.relative_to(directory))
            yield from _open_to_others(path, name, f"it contains {', '.join(secrets)}")
    logs = directory / "data" / "logs"
    yield from _open_to_others(logs, str(logs), "it contains the logs")
    if storage.cloud == "local":
        folder = storage.data_dir
        yield from _open_to_others(folder, str(folder), "it contains the models of the bucket")


def review_memory(
    workers: int, place: Place, parameters: Hyperparameters | None, metadata: ModelMetadata | None
) -> Iterator[Problem]:
    needed = workers * WORKER_BYTES + TRAINER_BYTES
    if parameters is not None and metadata is not None and metadata.algorithm.replay:
        needed += getattr(parameters, metadata.algorithm.replay) * FRAME_BYTES * metadata.eyes
    free = psutil.virtual_memory().available
    if free < needed:
        what = (
            f"only {_shown(free)} of memory is free; a trainer with {workers} simulation "
            f"workers may need {_shown(needed)}."
        )
        remedy = "End other programs, or lower DR_WORKERS (or sac_replay_steps)."
        yield Problem("V-50", "warning", *place, what, remedy, "DR_WORKERS")


def review_gpu(devices: str, environ: Mapping[str, str]) -> Iterator[Problem]:
    """Without `devices`, CUDA_VISIBLE_DEVICES counts."""
    allowed = devices or environ.get("CUDA_VISIBLE_DEVICES")
    names = None if allowed is None else tuple(name.strip() for name in allowed.split(","))
    if names in (("",), ("-1",)):
        return
    prefixes = tuple(name for name in names or () if name.startswith("GPU-"))
    free = [
        card.free_bytes
        for card in graphics_cards()[0]
        # A GPU may be named by its number or by the beginning of its UUID.
        if names is None or card.index in names or card.uuid.startswith(prefixes)
    ]
    if free and max(free) < LEAST_GPU_BYTES:
        what = (
            f"only {_shown(max(free))} of GPU memory is free; learning may need "
            f"{_shown(LEAST_GPU_BYTES)}."
        )
        remedy = (
            "End other programs on the GPU, or learn on the processor with "
            "DR_SAGEMAKER_CUDA_DEVICES=-1 in system.env."
        )
        yield Problem("V-50", "warning", "nvidia-smi", None, what, remedy)


@dataclass(frozen=True)
class Card:
    """A GPU, as `nvidia-smi` describes it; `memory_bytes` 0: that of the machine."""

    index: str
    uuid: str
    name: str
    driver: str
    memory_bytes: int
    free_bytes: int


def graphics_cards() -> tuple[list[Card], str]:
    """NVIDIA's, and why they cannot be asked."""
    program = shutil.which("nvidia-smi")
    if program is None:
        return [], ""
    wanted = "--query-gpu=index,uuid,name,driver_version,memory.total,memory.free"
    try:
        done = subprocess.run(
            [program, wanted, "--format=csv,noheader,nounits"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=GPU_PATIENCE_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return [], f"no answer within {GPU_PATIENCE_S:.0f} s."
    except OSError as error:
        return [], f"{error.strerror or error}."
    lines = done.stdout.strip().splitlines()
    if done.returncode != 0:
        said = [*lines, *done.stderr.strip().splitlines()]
        return [], said[0] if said else f"exit code {done.returncode}."
    cards = []
    for words in (line.strip().split(", ") for line in lines):
        if len(words) == 6:
            # A GPU that shares the memory of the machine answers `[N/A]`.
            index, uuid, name, driver, *sizes = words
            total, free = (int(size) * 2**20 if size.isdigit() else 0 for size in sizes)
            free = free if total else LEAST_GPU_BYTES
            cards.append(Card(index, uuid, name, driver, total, free))
    return cards, ""


def _open_to_others(path: Path, name: str, why: str) -> Iterator[Problem]:
    try:
        if not others_may_read(path):
            return
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError:  # it does not exist, or belongs to somebody else
        return
    what = f"other users of this machine may read {name} (mode {mode:o}), and {why}."
    remedy = f"Run `chmod go= {quote(str(path))}`; `dr docs security` says how a group shares it."
    yield Problem("V-50", "warning", name, None, what, remedy)


def _secrets_in(path: Path) -> list[str]:
    try:
        entries = parse_env(read_regular(path), path.name).last
    except (OSError, ProblemsError):  # other rules say so
        return []
    return [name for name, entry in entries.items() if is_secret(name, entry.value)]


def _shown(size_bytes: int) -> str:
    return f"{size_bytes / 1e9:.1f} GB"
