"""Records the start of a training: seed, settings, versions, code and machine.

It is below the model prefix, so copies have it.
"""

import os
import platform
import subprocess
from collections.abc import Container, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from drcli.bucket.bucket import (
    ObjectDamaged,
    ObjectNewer,
    find_record,
)
from drcli.config.fields import hidden
from drcli.config.run_config import SUPERVISOR_ONLY
from drcli.config.settings import Settings, catalogue
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.training_record import GitState, Pretrained, TrainingStart

PACKAGES = ("drcli", "torch", "mujoco", "numpy", "numba")
"""Their versions change the course of a training."""

PROGRAM_PATIENCE_S = 5.0


def describe_start(
    settings: Settings,
    seed: int,
    pretrained: Pretrained | None,
    before: TrainingStart | None,
    training: str = "",
) -> TrainingStart:
    return TrainingStart(
        seed=seed,
        started_at=datetime.now(UTC).isoformat(timespec="seconds"),
        settings=chosen_settings(settings),
        cars=[race.sim_car for race in settings.races],
        workers=[
            _stored(settings.for_worker(k), own.sources)
            for k, own in enumerate(settings.overrides, start=1)
        ],
        versions={"python": platform.python_version(), **installed_versions(PACKAGES)},
        git={
            "working_folder": _git_state(settings.directory, "."),
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


def read_start(model: ModelStore) -> TrainingStart | None:
    """The last start; ObjectDamaged if unreadable."""
    return find_record(model.bucket, keys.training_start(model.prefix), TrainingStart.decode)


def metric_of(model: ModelStore) -> str:
    with suppress(ObjectDamaged, ObjectNewer):
        start = read_start(model)
        if start is not None and start.settings is not None:
            name = "DR_TRAIN_BEST_MODEL_METRIC"
            return str(start.settings.get(name, catalogue()[name].default))
    return ""


def chosen_settings(settings: Settings) -> dict[str, Any]:
    """Non-default ones that affect a training; hides secrets."""
    return _stored(
        settings,
        {
            name
            for name, setting in catalogue().items()
            # Who uses which other system is nobody's business.
            if not name.startswith("DR_DROA_")
            and name not in SUPERVISOR_ONLY
            and name in settings.sources
            and getattr(settings, setting.field) != setting.default
        },
    )


def _stored(settings: Settings, names: Container[str]) -> dict[str, Any]:
    found = {}
    for name, setting in catalogue().items():
        if name in names and setting.effect != "accepted":
            value = getattr(settings, setting.field)
            is_text = isinstance(value, str | Path)
            found[name] = hidden(name, str(value)) if is_text else value
    return found


def installed_versions(packages: Sequence[str]) -> dict[str, str | None]:
    versions: dict[str, str | None] = dict.fromkeys(packages)
    for package in packages:
        with suppress(metadata.PackageNotFoundError):
            versions[package] = metadata.version(package)
    return versions


def output_of(*command: str) -> str | None:
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
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name" and value.strip():
                return value.strip()
    return platform.processor() or platform.machine()


def _git_state(folder: Path, tracked: str) -> GitState | None:
    """None if untracked, such as a package in a repository's `.venv`."""
    if not _git(folder, "ls-files", "--", tracked):
        return None
    commit = _git(folder, "rev-parse", "--verify", "HEAD")
    if commit is None:
        return None
    changes = _git(folder, "status", "--porcelain", "--untracked-files=no")
    return GitState(commit, dirty=bool(changes))


def _git(folder: Path, *arguments: str) -> str | None:
    return output_of("git", "-C", str(folder), *arguments)
