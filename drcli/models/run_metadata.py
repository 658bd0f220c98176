"""Records the start of a training: seed, settings, versions, code and machine.

The record is kept below the model prefix, so every copy of the model has it. The three files that
the racer wrote are there too.
"""

import os
import platform
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from drcli.config.run_config import SUPERVISOR_ONLY
from drcli.config.setting_problems import hidden
from drcli.config.settings import Settings, catalogue
from drcli.exchange.training_start import GitState, Pretrained, TrainingStart
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, ObjectNewer, read_record
from drcli.store.remedies import remedy_of

PACKAGES = ("drcli", "torch", "mujoco", "numpy", "numba")
"""Packages whose versions change the course of a training."""

PROGRAM_PATIENCE_S = 5.0


def describe_start(
    settings: Settings,
    directory: Path,
    seed: int,
    pretrained: Pretrained | None,
    before: TrainingStart | None,
    training: str = "",
) -> TrainingStart:
    """Record everything that can change the course of a training.

    `before` is the start that this one resumes, None for a new model. `training` is the id of the
    record of the training.
    """
    return TrainingStart(
        seed=seed,
        started_at=datetime.now(UTC).isoformat(timespec="seconds"),
        settings=chosen_settings(settings),
        cars=[race.sim_car for race in settings.races],
        versions={"python": platform.python_version(), **installed_versions(PACKAGES)},
        git={
            "working_folder": _git_state(directory, "."),
            "package": _git_state(Path(str(resources.files("drcli"))), "__init__.py"),
        },
        machine={
            "platform": platform.platform(),
            "processor": processor_name(),
            "cores": os.cpu_count(),
            "threads": os.environ.get("OMP_NUM_THREADS"),
        },
        pretrained=pretrained if before is None else before.pretrained or pretrained,
        earlier=[] if before is None else [*before.earlier, replace(before, earlier=[])],
        training=training,
    )


def read_start(bucket: Bucket, prefix: str) -> TrainingStart | None:
    """The last start of a model, None if it has no record.

    Raises:
        ObjectDamaged: It is unreadable.
    """
    key = keys.training_start(prefix)
    try:
        return read_record(bucket, key, TrainingStart.decode, remedy_of(key))
    except ObjectMissing:
        return None


def metric_of(bucket: Bucket, prefix: str) -> str:
    """DR_TRAIN_BEST_MODEL_METRIC of the last start of a model; empty if nobody recorded it."""
    with suppress(ObjectDamaged, ObjectNewer):
        start = read_start(bucket, prefix)
        if start is not None and start.settings is not None:
            name = "DR_TRAIN_BEST_MODEL_METRIC"
            return str(start.settings.get(name, catalogue()[name].default))
    return ""


def chosen_settings(settings: Settings) -> dict[str, Any]:
    """DR_ settings with other values than their defaults, as plain values.

    Leaves out settings that do nothing here or for a training, and hides secrets.
    """
    chosen = {}
    for name, setting in catalogue().items():
        value = getattr(settings, setting.field)
        # Who uses which other system is nobody's business.
        if name.startswith("DR_DROA_") or name in SUPERVISOR_ONLY:
            continue
        if name in settings.sources and setting.effect != "accepted" and value != setting.default:
            is_text = isinstance(value, str | Path)
            chosen[name] = hidden(name, str(value)) if is_text else value
    return chosen


def installed_versions(packages: Sequence[str]) -> dict[str, str | None]:
    """Versions of packages, None for one that is not installed."""
    versions: dict[str, str | None] = dict.fromkeys(packages)
    for package in packages:
        with suppress(metadata.PackageNotFoundError):
            versions[package] = metadata.version(package)
    return versions


def output_of(*command: str) -> str | None:
    """The output of a program; None if it fails, is not installed or takes too long."""
    try:
        done = subprocess.run(
            command,
            env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=PROGRAM_PATIENCE_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def processor_name() -> str:
    """Name of the processor, or its architecture if the system does not give a name."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name" and value.strip():
                return value.strip()
    return platform.processor() or platform.machine()


def _git_state(folder: Path, tracked: str) -> GitState | None:
    """The git state of a folder; None if git does not track that file or folder in it.

    A package that is installed inside a repository, in its `.venv`, is not tracked there.
    """
    if not _git(folder, "ls-files", "--", tracked):
        return None
    commit = _git(folder, "rev-parse", "--verify", "HEAD")
    if commit is None:
        return None
    changes = _git(folder, "status", "--porcelain", "--untracked-files=no")
    return GitState(commit, dirty=bool(changes))


def _git(folder: Path, *arguments: str) -> str | None:
    return output_of("git", "-C", str(folder), *arguments)
