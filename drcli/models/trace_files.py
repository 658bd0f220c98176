"""Finds traces: in files and folders, or a model's."""

from collections.abc import Iterable
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.left_behind import is_left_behind
from drcli.base.regular_file import read_regular
from drcli.modelfiles.driven_actions import DrivenFile, read_steps
from drcli.store.bucket import Bucket, ObjectMissing
from drcli.store.model_traces import traces_of

NEWEST_TRACES = 20
"""Older training traces show a worse driver."""

_MOST_FILES = 5_000


def traces_in_folders(paths: Iterable[Path]) -> list[DrivenFile]:
    """Read files and the `.csv` in folders; SettingsError without a trace."""
    found: list[DrivenFile] = []
    for path in paths:
        if not path.is_dir():
            found.append(read_steps(_content(path), str(path)))
            continue
        inside = []
        files = (file for file in path.rglob("*.csv") if not is_left_behind(file.name))
        for file in sorted(files)[:_MOST_FILES]:
            try:
                inside.append(read_steps(_content(file), str(file)))
            except SettingsError:
                continue
        if not inside:
            raise SettingsError(
                f"{path} holds no trace of a drive.",
                remedy="Name a folder such as training-simtrace/, or a file in it.",
            )
        found += inside
    return found


def traces_of_model(bucket: Bucket, prefix: str) -> list[DrivenFile]:
    """Of all evaluations and the newest training; SettingsError without any."""
    own = traces_of(bucket, prefix).objects  # none of a model inside it
    listed = [info.key for info in own if info.key.endswith(".csv")]
    training = [key for key in listed if "/training-simtrace/" in key[len(prefix) :]]
    evaluation = [key for key in listed if "/evaluation-simtrace/" in key[len(prefix) :]]
    training.sort(key=_iteration)
    found = []
    for key in [*evaluation, *training[-NEWEST_TRACES:]]:
        try:
            found.append(read_steps(bucket.get(key), key))
        except (SettingsError, ObjectMissing):
            continue  # half written, or deleted since it was listed
    if not found:
        raise SettingsError(
            f"s3://{bucket.name}/{prefix} has no trace of a drive.",
            remedy="Train or evaluate the model first, or name a trace file.",
        )
    return found


def _iteration(key: str) -> tuple[int, str]:
    number = key.rpartition("/")[2].partition("-")[0]
    return (int(number) if number.isdecimal() else -1), key


def _content(path: Path) -> bytes:
    try:
        return read_regular(path)
    except OSError as error:
        raise SettingsError(
            f"{path} cannot be read: {error.strerror or error}.",
            remedy="Name a simtrace file, a log, or a folder with such files.",
        ) from None
