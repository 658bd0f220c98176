"""What a training was started with: seed, settings, versions, code and machine.

The record is kept below the model prefix, so that a model tells where it is from wherever it is
copied to. The three files that the racer wrote are beside it.
"""

import os
import platform
import subprocess
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from drcli.config.setting_problems import hidden
from drcli.config.settings import Settings, catalogue
from drcli.exchange.training_start import GitState, Pretrained, TrainingStart
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing, read_record

PACKAGES = ("drcli", "torch", "mujoco", "numpy", "numba")
"""Packages whose versions decide how a training goes."""

GIT_PATIENCE_S = 5.0


def describe_start(
    settings: Settings,
    directory: Path,
    seed: int,
    pretrained: Pretrained | None,
    before: TrainingStart | None,
) -> TrainingStart:
    """Look at everything that decides how a training goes.

    Args:
        settings: As the racer wrote them.
        directory: The racer's working folder.
        seed: Of this start.
        pretrained: Whose weights a new model begins with.
        before: The start that this one resumes; None for a new model.
    """
    return TrainingStart(
        seed=seed,
        started_at=datetime.now(UTC).isoformat(timespec="seconds"),
        settings=chosen_settings(settings),
        versions={"python": platform.python_version(), **{p: _version(p) for p in PACKAGES}},
        git={
            "working_folder": _git_state(directory, "."),
            "package": _git_state(Path(str(resources.files("drcli"))), "__init__.py"),
        },
        machine={
            "platform": platform.platform(),
            "processor": _processor(),
            "cores": os.cpu_count(),
            "threads": os.environ.get("OMP_NUM_THREADS"),
        },
        pretrained=pretrained if before is None else before.pretrained or pretrained,
        earlier=[] if before is None else [*before.earlier, replace(before, earlier=[])],
    )


def write_start(bucket: Bucket, prefix: str, start: TrainingStart) -> None:
    """Put the record below the model prefix."""
    bucket.put(keys.training_start(prefix), start.encode())


def read_start(bucket: Bucket, prefix: str) -> TrainingStart | None:
    """The last start of a model, None where there is none.

    Raises:
        ObjectDamaged: It is unreadable.
    """
    remedy = "Go on with `dr-start-training --resume`, which writes it again."
    try:
        return read_record(bucket, keys.training_start(prefix), TrainingStart.decode, remedy)
    except ObjectMissing:
        return None


def chosen_settings(settings: Settings) -> dict[str, Any]:
    """DR_ settings that somebody set to something else than their default, as plain values.

    Settings that do nothing here are left out, and what nobody may read is hidden.
    """
    chosen = {
        name: _plain(getattr(settings, setting.field))
        for name, setting in catalogue().items()
        if name in settings.sources
        and setting.effect != "accepted"
        and getattr(settings, setting.field) != setting.default
    }
    return {
        name: hidden(name, value) if isinstance(value, str) else value
        for name, value in chosen.items()
    }


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value


def _processor() -> str:
    """Name of the processor, as far as the system tells; else its architecture."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name" and value.strip():
                return value.strip()
    return platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _git_state(folder: Path, tracked: str) -> GitState | None:
    """What git says about a folder; None where it does not track that file or folder in it.

    A package that is installed below somebody's repository, in its `.venv`, is no part of that.
    """
    if not _git(folder, "ls-files", "--", tracked):
        return None
    commit = _git(folder, "rev-parse", "--verify", "HEAD")
    if commit is None:
        return None
    changes = _git(folder, "status", "--porcelain", "--untracked-files=no")
    return GitState(commit, dirty=bool(changes))


def _git(folder: Path, *arguments: str) -> str | None:
    """What git prints; None where it fails, is not installed or takes too long."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=GIT_PATIENCE_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
