"""Goes on from a model under a new name: edits run.env so that the next start clones it."""

import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from drcli.config import Settings, load_settings
from drcli.envfile import parse_env, with_values
from drcli.errors import SettingsError
from drcli.runs import lease
from drcli.runs.plan import COMMAND_PATIENCE_S, refuse_second_run
from drcli.runs.prefix import contains, is_used, wipe
from drcli.runs.pretrained import Pretrained, read_weights
from drcli.runs.record import run_folder
from drcli.store.connect import open_bucket

MODEL = "DR_LOCAL_S3_MODEL_PREFIX"
METRICS = "DR_LOCAL_S3_METRICS_PREFIX"
PRETRAINED = "DR_LOCAL_S3_PRETRAINED"
PRETRAINED_PREFIX = "DR_LOCAL_S3_PRETRAINED_PREFIX"

DELIMITER = "-"
"""Stands before the number of a name that has none yet."""

_REFERENCE = re.compile(r"\$\{\w+(?::-[^}]*)?\}|\$[A-Za-z_]\w*", re.ASCII)
_NAME_AT_END = re.compile(r"\$([A-Za-z_]\w*)\Z", re.ASCII)


@dataclass(frozen=True)
class Increment:
    """A step from one model to the next.

    Attributes:
        file: The run.env that is edited.
        backup: Copy of it as it was before.
        bucket: Name of the bucket.
        before: Prefix of the model to go on from.
        after: Prefix of the new model.
        pretrained: The weights that the new model will begin with, as they are now.
        wipes: Whether there is something at the new prefix, to be deleted.
    """

    file: str
    backup: str
    bucket: str
    before: str
    after: str
    pretrained: Pretrained
    wipes: bool


@dataclass(frozen=True)
class PlannedIncrement:
    """An increment that can be made.

    Attributes:
        step: What it changes.
        old: Content of the file when it was looked at.
        new: Its content afterwards.
    """

    step: Increment
    old: bytes
    new: bytes


def plan_increment(
    settings: Settings,
    directory: Path,
    *,
    prefix: str | None = None,
    delimiter: str | None = None,
    wiping: bool = False,
) -> PlannedIncrement:
    """Check everything and work out the edit; nothing is changed yet.

    Args:
        settings: As they are before.
        directory: The racer's working folder.
        prefix: Name of the new model; the present one with its number raised if left out.
        delimiter: What must stand before that number; anything but a digit if left out.
        wiping: Whether what lies at the new prefix may be deleted.

    Raises:
        DrError: The first thing that is wrong.
    """
    refuse_second_run(settings, run_folder(settings, directory))
    _refuse_stronger_values(settings)
    name, before = _file_name(settings), settings.model_prefix
    path = directory / name
    data = path.read_bytes()
    entries = {entry.name: entry.value for entry in parse_env(data, name).entries}
    if prefix is not None:
        written = after = prefix
    else:
        written, after = raised(entries.get(MODEL) or before, before, delimiter)
    _refuse_nested(before, after)
    _refuse_left_behind(settings, directory, after)

    bucket = open_bucket(settings, directory, patience_s=COMMAND_PATIENCE_S)
    place = f"{settings.source(MODEL)}: {MODEL}={before}"
    pretrained, _ = read_weights(bucket, before, settings.pretrained_checkpoint, place)
    used = is_used(bucket, after)
    if used and not wiping:
        raise SettingsError(
            f"There is a model at s3://{bucket.name}/{after} already.",
            remedy="Name the new model with -p, or delete that one with -w.",
        )
    if used:
        lease.refuse_other_owner(bucket, after)
    new = with_values(data, {PRETRAINED: "True", PRETRAINED_PREFIX: before, MODEL: written}, name)
    backup = path.with_name(f"{path.name}.bak")
    step = Increment(str(path), str(backup), bucket.name, before, after, pretrained, used)
    return PlannedIncrement(step, data, new)


def make_increment(planned: PlannedIncrement, settings: Settings, directory: Path) -> None:
    """Delete what is to be wiped, keep a copy of the file, and replace it in one step.

    Raises:
        SettingsError: The file was changed since it was looked at, or cannot be written.
        StorageError: The bucket could not be wiped; the file is as it was.
    """
    path = Path(planned.step.file)
    if path.read_bytes() != planned.old:
        raise SettingsError(
            f"{path}: was changed while this command waited.", remedy="Run the command again."
        )
    if planned.step.wipes:
        wipe(open_bucket(settings, directory, patience_s=COMMAND_PATIENCE_S), planned.step.after)
    target = path.resolve()
    scratch = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        shutil.copy2(target, planned.step.backup)
        shutil.copy2(target, scratch)
        scratch.write_bytes(planned.new)
        scratch.replace(target)
    except OSError as e:
        scratch.unlink(missing_ok=True)
        raise SettingsError(
            f"{path}: cannot be written ({e.strerror or e}).",
            remedy=f"Check that you may write {path} and its folder.",
        ) from e


def raised(written: str, prefix: str, delimiter: str | None = None) -> tuple[str, str]:
    """The name of the next model: the number at its end raised, or a first number behind it.

    Leading zeros stay, so m-09 becomes m-10. A name that is nothing but a number gets another one,
    and digits that belong to a `$NAME` are none.

    Args:
        written: The prefix as it stands in the file, maybe with `$NAME` in it.
        prefix: The same with everything filled in.
        delimiter: What must stand before the number; anything but a digit if left out.

    Returns:
        Both as they are for the next model.
    """
    digits = _number_at_end(written, delimiter)
    if digits:
        number = str(int(digits) + 1).zfill(len(digits))
        return written.removesuffix(digits) + number, prefix.removesuffix(digits) + number
    number = f"{delimiter or DELIMITER}1"
    if re.match(r"\w", number):
        # Without braces, `$NAME` and `_1` would be read as one name.
        written = _NAME_AT_END.sub(r"${\1}", written)
    return written + number, prefix + number


def _number_at_end(written: str, delimiter: str | None) -> str:
    literal = max((match.end() for match in _REFERENCE.finditer(written)), default=0)
    found = re.search(r"[0-9]+\Z", written[literal:])
    if found is None:
        return ""
    name = written.removesuffix(found[0])
    counts = bool(name) if delimiter is None else name.endswith(delimiter)
    return found[0] if counts else ""


def _file_name(settings: Settings) -> str:
    name = settings.experiment_name
    return f"experiments/{name}/run.env" if name else "run.env"


def _refuse_stronger_values(settings: Settings) -> None:
    """What the environment says wins over run.env, so that an edit there would do nothing."""
    for name in (MODEL, PRETRAINED, PRETRAINED_PREFIX):
        if settings.source(name) == "environment":
            raise SettingsError(
                f"environment: {name} is set there and would win over {_file_name(settings)}.",
                remedy=f"Remove it with `unset {name}` and run the command again.",
            )


def _refuse_nested(before: str, after: str) -> None:
    if contains(before, after) or contains(after, before):
        how = "the same model as" if before == after else "not beside"
        raise SettingsError(
            f"{after} would be {how} {before}, and wiping one would delete the other.",
            remedy="Choose another name with -p.",
        )


def _refuse_left_behind(settings: Settings, directory: Path, after: str) -> None:
    """Load the settings as they will be: nothing in them may be wrong or name the old model."""
    before = settings.model_prefix
    edited = {MODEL: after, PRETRAINED: "True", PRETRAINED_PREFIX: before}
    metrics = load_settings(directory, flags=edited).metrics_prefix
    if contains(before, metrics):
        raise SettingsError(
            f"{settings.source(METRICS)}: {METRICS}={metrics} would keep the new model's metrics "
            f"with those of {before}.",
            remedy=f"Write {METRICS}=${MODEL}/metrics.",
        )
