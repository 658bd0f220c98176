"""Words that the Tab key completes.

Nothing here starts a process or asks a network: somebody waits.
"""

import os
import re
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from pathlib import Path

from drcli.base.errors import DrError
from drcli.cli.working_folder import working_folder
from drcli.config import activation

MOST_FOLDERS = 2000
"""Each takes about 20 microseconds."""

LOGS = ("sim", "trainer", "supervisor", "evaluation", "reward")
"""`sim` is a worker, `reward` what the reward function prints there."""

_CHECKPOINT = re.compile(r"(\d+)_Step-\d+\.ckpt")


def worlds() -> list[str]:
    from drcli.config.track_names import built_in, own

    return [*built_in(), *own(working_folder() / (_settings().get("DR_TRACKS_DIR") or "tracks"))]


def model_prefixes() -> list[str]:
    settings = _settings()
    bucket, configured = _bucket(settings), settings.get("DR_LOCAL_S3_MODEL_PREFIX")
    models = [configured] if configured else []
    return list(dict.fromkeys(models if bucket is None else [*models, *_models_in(bucket)]))


def races() -> list[str]:
    bucket = _bucket(_settings())
    folders = [] if bucket is None else (bucket / "races").glob("*/race.json")
    return sorted(path.parent.name for path in folders)


def checkpoints() -> list[str]:
    from drcli.config.checkpoint_words import WORDS

    settings = _settings()
    bucket, prefix = _bucket(settings), settings.get("DR_LOCAL_S3_MODEL_PREFIX")
    if bucket is None or not prefix:
        return list(WORDS)
    names = _names(bucket / prefix / "model")
    numbers = {int(match[1]) for name in names if (match := _CHECKPOINT.match(name))}
    return [*(str(number) for number in sorted(numbers, reverse=True)), *WORDS]


def presets() -> list[str]:
    from drcli.config.presets import preset_names

    return preset_names()


def experiments() -> list[str]:
    return sorted(path.parent.name for path in working_folder().glob("experiments/*/run.env"))


def ready_made_models() -> list[str]:
    from drcli.config.example_files import ready_made

    return list(ready_made())


def workers() -> list[str]:
    count = _settings().get("DR_WORKERS", "1")
    sims = min(int(count), 100) if count.isdecimal() else 1
    return [*LOGS, *(f"sim-{k}" for k in range(sims))]


def race_types() -> list[str]:
    return _choices("DR_RACE_TYPE")


def clouds() -> list[str]:
    return _choices("DR_CLOUD")


def setting_names() -> list[str]:
    from drcli.config.settings import catalogue

    return sorted(catalogue())


def explained_words() -> list[str]:
    from drcli.explain.lookup import every_entry

    return sorted({entry.name for entry in every_entry() if entry.kind != "error text"})


def assignments(incomplete: str) -> list[str]:
    """`NAME=`, or `NAME=VALUE` once that is typed."""
    name, is_typed, _ = incomplete.partition("=")
    if not is_typed:
        return [f"{name}=" for name in setting_names()]
    known: Mapping[str, Callable[[], list[str]]] = {
        "DR_WORLD_NAME": worlds,
        "DR_EXPERIMENT_NAME": experiments,
        "DR_LOCAL_S3_MODEL_PREFIX": model_prefixes,
        "DR_LOCAL_S3_PRETRAINED_PREFIX": model_prefixes,
    }
    return [f"{name}={value}" for value in (known[name]() if name in known else _choices(name))]


def _choices(name: str) -> list[str]:
    from drcli.config.settings import catalogue

    setting = catalogue().get(name)
    return [] if setting is None else list(setting.choices)


def _settings() -> Mapping[str, str]:
    from drcli.config.shell_variables import shell_change

    try:
        change = shell_change(working_folder(), os.environ)
    except DrError:
        return {}
    return {**activation.chosen(os.environ), **change.export}


def _bucket(settings: Mapping[str, str]) -> Path | None:
    if settings.get("DR_CLOUD", "local") != "local":
        return None
    data = working_folder() / settings.get("DR_S3_DATA_DIR", "data/s3")
    return data / settings.get("DR_LOCAL_S3_BUCKET", "bucket")


def _models_in(bucket: Path) -> Iterator[str]:
    for folder, below, _ in islice(os.walk(bucket), MOST_FOLDERS):
        if "model" in below and any(map(_CHECKPOINT.match, _names(Path(folder, "model")))):
            below.clear()
            yield Path(folder).relative_to(bucket).as_posix()
        if Path(folder) == bucket and "races" in below:
            below.remove("races")  # copies, which nobody trains on
        below.sort()


def _names(folder: Path) -> list[str]:
    try:
        return [path.name for path in folder.iterdir()]
    except OSError:
        return []
