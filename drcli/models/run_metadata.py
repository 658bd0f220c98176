"""What a training was started with: seed, settings, versions, code and machine.

The note lies below the model prefix, so that a model tells where it is from wherever it is copied
to. The three files that the racer wrote lie beside it.
"""

import json
import os
import platform
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from drcli.base.json_record import built, parsed
from drcli.config.settings import Settings, catalogue, hidden
from drcli.models.pretrained import Pretrained
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing, read_record

PACKAGES = ("drcli", "torch", "mujoco", "numpy", "numba")
"""Packages whose versions decide how a training goes."""

GIT_PATIENCE_S = 5.0


@dataclass(frozen=True)
class GitState:
    """Which version of some files git knows.

    Attributes:
        dirty: Whether a file that git tracks was changed since.
    """

    commit: str
    dirty: bool


@dataclass(frozen=True)
class RunNote:
    """One start of a training.

    Attributes:
        seed: What its random numbers are derived from.
        started_at: Time in UTC, ISO 8601.
        settings: DR_ settings that differ from their defaults.
        versions: Python and the packages that matter; None where one is not installed.
        git: State of the racer's `working_folder` and of our own `package`; None outside git.
        machine: `platform`, `processor`, number of `cores`, and `threads` where OMP_NUM_THREADS
            limits them.
        pretrained: Whose weights the model began with; None where they were fresh.
        earlier: The notes of the starts before that this one resumes, oldest first.
    """

    seed: int
    started_at: str
    settings: dict[str, Any]
    versions: dict[str, str | None]
    git: dict[str, GitState | None]
    machine: dict[str, Any]
    pretrained: Pretrained | None
    earlier: list[dict[str, Any]]


def take_note(
    settings: Settings,
    directory: Path,
    seed: int,
    pretrained: Pretrained | None,
    before: Mapping[str, Any] | None,
) -> RunNote:
    """Look at everything that decides how a training goes.

    Args:
        settings: As the racer wrote them.
        directory: The racer's working folder.
        seed: Of this start.
        pretrained: Whose weights a new model begins with.
        before: The note of the start that this one resumes; None for a new model.
    """
    past = dict(before or {})
    earlier = [*past.pop("earlier", []), past] if past else []
    origin = past.get("pretrained")
    return RunNote(
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
        pretrained=Pretrained(**origin) if origin else pretrained,
        earlier=earlier,
    )


def write_note(bucket: Bucket, prefix: str, note: RunNote) -> None:
    """Put the note below the model prefix."""
    bucket.put(keys.run_note(prefix), json.dumps(asdict(note), allow_nan=False).encode())


def read_note(bucket: Bucket, prefix: str) -> dict[str, Any] | None:
    """The note of a model's last start, None where there is none.

    Older notes hold the seed only, so what is read stays a dictionary.

    Raises:
        ObjectDamaged: It is unreadable.
    """
    remedy = "Go on with `dr-start-training --resume`, which writes it again."
    try:
        return read_record(bucket, keys.run_note(prefix), _decode, remedy)
    except ObjectMissing:
        return None


def _decode(data: bytes) -> dict[str, Any]:
    note: dict[str, Any] = parsed(data)
    built(_Known, note)
    return note


@dataclass(frozen=True)
class _Known:
    """What a start needs of the note of the one before."""

    seed: int
    settings: dict[str, Any] = field(default_factory=dict)
    pretrained: Pretrained | None = None
    earlier: list[dict[str, Any]] = field(default_factory=list)


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
