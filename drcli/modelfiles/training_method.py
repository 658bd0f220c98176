"""Writes training_method into a hyperparameters.json."""

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import PurePosixPath

from drcli.base.errors import SettingsError
from drcli.base.problems import ProblemsError
from drcli.config.write_folder import FolderPlan
from drcli.modelfiles.custom_files import InputFile
from drcli.modelfiles.hyperparameters import Hyperparameters, TrainingMethod
from drcli.modelfiles.model_metadata import ModelMetadata
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing

_KEY = "training_method"
_WRITTEN = re.compile(rf'"{_KEY}"\s*:\s*("[^"\n]*"|[^,}}\s]+)')


def method_of(teacher: bool) -> TrainingMethod:
    return "teacher" if teacher else "camera"


def with_method(data: bytes, method: TrainingMethod, *, own_line: bool = False) -> bytes:
    """The file with that method, unless it is not an object.

    All else stays in its line, which messages name.
    """
    text = data.decode("utf-8-sig", "surrogateescape")
    written = f'"{_KEY}": "{method}"'
    changed, count = _WRITTEN.subn(written, text, 1)
    if not count:
        before, brace, after = text.partition("{")
        if not brace:
            return data
        comma = "" if after.lstrip().startswith("}") else ","
        gap = "\n  " if own_line else ""
        changed = f"{before}{{{gap}{written}{comma}{'' if own_line else ' '}{after}"
    return changed.encode("utf-8", "surrogateescape")


def plan_with_method(plan: FolderPlan, teacher: bool) -> FolderPlan:
    """Raises SettingsError without hyperparameters.json, or with sac."""
    at = {PurePosixPath(file.name).name: file for file in plan.files}
    file, metadata = at.get(keys.HYPERPARAMETERS_FILE), at.get(keys.MODEL_METADATA_FILE)
    if file is None:
        raise SettingsError(
            f"--teacher: there is no {keys.HYPERPARAMETERS_FILE} to write training_method into.",
            remedy="Start with `dr-start-training --teacher` instead.",
        )
    if teacher and metadata is not None and is_sac(metadata.data):
        raise SettingsError(
            "--teacher: training_method=teacher goes on with clipped_ppo, but "
            f"{metadata.name} has training_algorithm=sac.",
            remedy="Leave out --teacher, or choose another --preset.",
        )
    changed = replace(file, data=with_method(file.data, method_of(teacher), own_line=True))
    return replace(plan, files=tuple(changed if each is file else each for each in plan.files))


def is_sac(metadata: bytes) -> bool:
    with suppress(ProblemsError):
        return ModelMetadata.from_bytes(metadata).training_algorithm == "sac"
    return False


def chosen_method(
    files: Mapping[str, InputFile], method: TrainingMethod | None, kept: TrainingMethod | None
) -> dict[str, InputFile]:
    """An option's `method`, else the file's, else that `kept` by the model."""
    file = files.get(keys.HYPERPARAMETERS_FILE)
    wanted = method or kept
    if file is None or wanted is None or (method is None and _WRITTEN.search(_text(file))):
        return dict(files)
    return {**files, file.name: replace(file, data=with_method(file.data, wanted))}


def kept_method(bucket: Bucket, prefix: str | None) -> TrainingMethod | None:
    """A model's, if it has a teacher."""
    if prefix is None:
        return None
    with suppress(ObjectMissing, ProblemsError):
        parameters = Hyperparameters.from_bytes(bucket.get(keys.hyperparameters(prefix)))
        return "teacher" if parameters.taught else None
    return None


def _text(file: InputFile) -> str:
    return file.data.decode("utf-8-sig", "replace")
