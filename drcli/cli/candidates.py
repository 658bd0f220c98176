"""What the Tab key may complete: worlds, models, settings and the like, for `autocompletion=`.

Nothing is started and no network is asked: who presses Tab waits for an answer.
"""

import os
import re
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from pathlib import Path

from drcli.base.errors import DrError
from drcli.cli.working_folder import working_folder
from drcli.config import activation
from drcli.config.settings import catalogue
from drcli.config.shell_variables import shell_change
from drcli.config.worlds import built_in, own

MOST_FOLDERS = 2000
"""Folders of a bucket that are looked into; a look costs some 20 microseconds."""

LOGS = ("sim", "trainer", "supervisor", "evaluation")
"""Who has a log; `sim` is the simulation worker that -n names."""

_CHECKPOINT = re.compile(r"(\d+)_Step-\d+\.ckpt")


def worlds() -> list[str]:
    """Tracks that are built in, and the racer's own."""
    return [*built_in(), *own(working_folder() / (_settings().get("DR_TRACKS_DIR") or "tracks"))]


def model_prefixes() -> list[str]:
    """The configured model, and all models in the bucket of this machine."""
    bucket, configured = _bucket(), _settings().get("DR_LOCAL_S3_MODEL_PREFIX")
    found = [] if bucket is None else _models_in(bucket)
    return list(dict.fromkeys([*([configured] if configured else []), *found]))


def checkpoints() -> list[str]:
    """Numbers of the configured model's checkpoints, the newest first."""
    bucket, prefix = _bucket(), _settings().get("DR_LOCAL_S3_MODEL_PREFIX")
    if bucket is None or not prefix:
        return []
    names = _names(bucket / prefix / "model")
    numbers = {int(match[1]) for name in names if (match := _CHECKPOINT.match(name))}
    return [str(number) for number in sorted(numbers, reverse=True)]


def experiments() -> list[str]:
    """Folders in experiments/ with a run.env."""
    return sorted(path.parent.name for path in working_folder().glob("experiments/*/run.env"))


def workers() -> list[str]:
    """Processes that have a log."""
    count = _settings().get("DR_WORKERS", "1")
    sims = min(int(count), 100) if count.isdecimal() else 1
    return [*LOGS, *(f"sim-{k}" for k in range(sims))]


def race_types() -> list[str]:
    """Values of DR_RACE_TYPE."""
    return list(catalogue()["DR_RACE_TYPE"].choices)


def clouds() -> list[str]:
    """Values of DR_CLOUD."""
    return list(catalogue()["DR_CLOUD"].choices)


def settings_files() -> list[str]:
    """Files that hold settings."""
    return ["run.env", "system.env"]


def setting_names() -> list[str]:
    """Every DR_ name."""
    return sorted(catalogue())


def assignments(incomplete: str) -> list[str]:
    """`NAME=` for every setting; once that is typed, `NAME=VALUE` where the values are known."""
    name, is_typed, _ = incomplete.partition("=")
    if not is_typed:
        return [f"{name}=" for name in setting_names()]
    known: Mapping[str, Callable[[], list[str]]] = {
        "DR_WORLD_NAME": worlds,
        "DR_EXPERIMENT_NAME": experiments,
        "DR_LOCAL_S3_MODEL_PREFIX": model_prefixes,
        "DR_LOCAL_S3_PRETRAINED_PREFIX": model_prefixes,
    }
    setting = catalogue().get(name)
    values = known[name]() if name in known else setting.choices if setting is not None else ()
    return [f"{name}={value}" for value in values]


def _settings() -> Mapping[str, str]:
    """Texts of the settings by DR_ name, unchecked; none where a file is broken."""
    try:
        change = shell_change(working_folder(), os.environ)
    except DrError:
        return {}
    return {**activation.chosen(os.environ), **change.export}


def _bucket() -> Path | None:
    """Folder with the objects of the embedded server; None for any other one."""
    settings = _settings()
    if settings.get("DR_CLOUD", "local") != "local":
        return None
    data = working_folder() / settings.get("DR_S3_DATA_DIR", "data/s3")
    return data / settings.get("DR_LOCAL_S3_BUCKET", "bucket")


def _models_in(bucket: Path) -> Iterator[str]:
    """Folders, on any level, that hold checkpoints in a folder `model`."""
    for folder, below, _ in islice(os.walk(bucket), MOST_FOLDERS):
        if "model" in below and any(map(_CHECKPOINT.match, _names(Path(folder, "model")))):
            below.clear()
            yield Path(folder).relative_to(bucket).as_posix()
        below.sort()


def _names(folder: Path) -> list[str]:
    try:
        return [path.name for path in folder.iterdir()]
    except OSError:
        return []
