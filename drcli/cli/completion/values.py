"""What may stand at a place of a command line, as far as a quick look at this machine can tell.

Nothing is started and no network is asked: who presses Tab waits for an answer.
"""

import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path

from drcli.base.errors import DrError
from drcli.config.worlds import built_in, own

RACE_TYPES = ("TIME_TRIAL", "OBJECT_AVOIDANCE", "HEAD_TO_BOT", "HEAD_TO_MODEL")
CLOUDS = ("local", "remote", "aws", "azure")

MOST_FOLDERS = 2000
"""Folders of a bucket that are looked into; a look costs some 20 microseconds."""

_SETTING = re.compile(r'\bsetting\(\s*"(DR_\w+)"')
_CHECKPOINT = re.compile(r"(\d+)_Step-\d+\.ckpt")


@dataclass(frozen=True)
class Place:
    """Where somebody presses Tab.

    Args:
        folder: The racer's working folder, which need not be one.
        typed: What stands of the word already.
    """

    folder: Path
    typed: str = ""

    @cached_property
    def settings(self) -> Mapping[str, str]:
        """Texts of the settings by DR_ name, unchecked; those of broken files are missing."""
        from drcli.config import activation
        from drcli.config.shell import shell_change

        try:
            change = shell_change(self.folder, os.environ)
        except DrError:
            return {}
        return {**activation.chosen(os.environ), **change.export}

    @property
    def bucket(self) -> Path | None:
        """Folder with the objects of the embedded server; None for any other one."""
        if self.settings.get("DR_CLOUD", "local") != "local":
            return None
        data = self.folder / self.settings.get("DR_S3_DATA_DIR", "data/s3")
        return data / self.settings.get("DR_LOCAL_S3_BUCKET", "bucket")


Values = Callable[[Place], Iterator[str]]
"""Looks for the words that may stand somewhere."""


def worlds(place: Place) -> Iterator[str]:
    """Tracks that are built in, and the racer's own."""
    yield from built_in()
    yield from own_tracks(place)


def own_tracks(place: Place) -> Iterator[str]:
    """The racer's own route files."""
    folder = place.folder / (place.settings.get("DR_TRACKS_DIR") or "tracks")
    yield from own(folder)


def model_prefixes(place: Place) -> Iterator[str]:
    """Models in the bucket of this machine, and the one that is configured."""
    configured = place.settings.get("DR_LOCAL_S3_MODEL_PREFIX")
    if configured:
        yield configured
    if place.bucket is not None:
        for found in _models_in(place.bucket):
            if found != configured:
                yield found


def checkpoints(place: Place) -> Iterator[str]:
    """Numbers of the configured model's checkpoints, the newest first."""
    prefix = place.settings.get("DR_LOCAL_S3_MODEL_PREFIX")
    if place.bucket is None or not prefix:
        return
    names = _names(place.bucket / prefix / "model")
    numbers = {int(match[1]) for name in names if (match := _CHECKPOINT.match(name))}
    yield from map(str, sorted(numbers, reverse=True))


def experiments(place: Place) -> Iterator[str]:
    """Folders in experiments/ with a run.env."""
    found = (place.folder / "experiments").glob("*/run.env")
    yield from sorted(path.parent.name for path in found)


def workers(place: Place) -> Iterator[str]:
    """Processes that have a log."""
    from drcli.cli.commands.logs import (  # the command whose words these are is loaded
        ANY_SIM,
        OTHERS,
    )

    count = place.settings.get("DR_WORKERS", "1")
    yield from (ANY_SIM, *OTHERS)
    yield from (f"sim-{k}" for k in range(min(int(count), 100) if count.isdecimal() else 1))


def race_types(place: Place) -> Iterator[str]:
    """Kinds of races."""
    yield from RACE_TYPES


def clouds(place: Place) -> Iterator[str]:
    """Who may serve the bucket."""
    yield from CLOUDS


def setting_names(place: Place) -> Iterator[str]:
    """Every DR_ name. Taken from the text of the declarations: to load them would take longer."""
    folder = Path(__file__).parents[2] / "config" / "groups"
    texts = (path.read_text("utf-8") for path in sorted(folder.glob("*.py")))
    yield from sorted(name for text in texts for name in _SETTING.findall(text))


def assignments(place: Place) -> Iterator[str]:
    """`NAME=` for every setting; once that is there, `NAME=VALUE` where the values are known."""
    name, is_there, _ = place.typed.partition("=")
    if not is_there:
        yield from (f"{name}=" for name in setting_names(place))
        return
    known: Mapping[str, Values] = {
        "DR_WORLD_NAME": worlds,
        "DR_RACE_TYPE": race_types,
        "DR_CLOUD": clouds,
        "DR_EXPERIMENT_NAME": experiments,
        "DR_LOCAL_S3_MODEL_PREFIX": model_prefixes,
        "DR_LOCAL_S3_PRETRAINED_PREFIX": model_prefixes,
    }
    if name in known:
        yield from (f"{name}={value}" for value in known[name](place))


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
