"""Finds the racer's three files, and copies them into the bucket."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

from drcli.base.errors import Problem, ProblemsError
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.config.presets import model_file
from drcli.config.run_config import CustomFilesConfig
from drcli.model import keys
from drcli.model.model_store import ModelStore

FILE_RULES = {
    keys.REWARD_FUNCTION_FILE: "V-02",
    keys.MODEL_METADATA_FILE: "V-03",
    keys.HYPERPARAMETERS_FILE: "V-04",
}
"""Broken if a file is missing or unreadable."""


@dataclass(frozen=True)
class InputFile:
    name: str
    data: bytes
    origin: str


@dataclass(frozen=True)
class Inputs:
    reward: InputFile
    hyperparameters: InputFile
    metadata: InputFile


def find(config: CustomFilesConfig, bucket: Bucket | None) -> dict[str, InputFile]:
    """The three files: in `custom_files/`, else in the bucket, else the examples.

    No examples for a single missing file, which is a mistake. `bucket` is None if unreadable.

    Raises:
        ProblemsError: A file in `custom_files/` cannot be read.
    """
    found: dict[str, InputFile] = {}
    for name, key in places(config).items():
        local = local_file(config.folder, name)
        if local is not None:
            found[name] = local
        elif bucket is not None:
            with suppress(ObjectMissing):
                found[name] = InputFile(name, bucket.get(key), f"{bucket.name}/{key}")
    if found or bucket is None:
        return found
    shipped = {name: model_file(name) for name in places(config)}
    return {name: InputFile(name, path.read_bytes(), str(path)) for name, path in shipped.items()}


def local_file(folder: Path, name: str) -> InputFile | None:
    """None if missing; ProblemsError if unreadable."""
    data = _content(folder / name)
    return None if data is None else InputFile(name, data, str(folder / name))


def places(config: CustomFilesConfig) -> dict[str, str]:
    return {
        keys.REWARD_FUNCTION_FILE: config.reward_key,
        keys.HYPERPARAMETERS_FILE: config.hyperparameters_key,
        keys.MODEL_METADATA_FILE: config.metadata_key,
    }


def missing_files(
    found: Mapping[str, InputFile], config: CustomFilesConfig, bucket: str
) -> list[Problem]:
    local = config.folder
    problems = []
    for name, key in places(config).items():
        if name not in found:
            what = f"{name} is missing, here and in the bucket at {bucket}/{key}."
            remedy = f"Put your {name} into {local}; an example is {model_file(name)}."
            problems.append(Problem(FILE_RULES[name], "error", str(local), None, what, remedy))
    return problems


def upload_custom_files(config: CustomFilesConfig, bucket: Bucket, inputs: Inputs) -> None:
    for file in (inputs.reward, inputs.hyperparameters, inputs.metadata):
        if Path(file.origin).parent == config.folder:
            bucket.put(places(config)[file.name], file.data)


def texts_of(inputs: Inputs) -> dict[str, str]:
    """As `Job.inputs` has them."""
    files = (inputs.reward, inputs.hyperparameters, inputs.metadata)
    return {file.name: file.data.decode("utf-8-sig") for file in files}


def write_model_files(
    model: ModelStore, files: Mapping[str, str], trained: Mapping[str, str] | None = None
) -> None:
    """Write `Job.inputs`, unless equal; of a `trained` model its own ones, and what is missing."""
    own = {
        keys.REWARD_FUNCTION_FILE: keys.reward_function(model.prefix),
        keys.HYPERPARAMETERS_FILE: keys.hyperparameters(model.prefix),
        keys.MODEL_METADATA_FILE: keys.model_metadata(model.prefix),
    }
    for name, text in (files if trained is None else {**files, **trained}).items():
        key, data = own.get(name) or keys.parameter_file(model.prefix, name), text.encode()
        with suppress(ObjectMissing):
            if model.bucket.get(key) == data or (trained is not None and name not in trained):
                continue
        model.bucket.put(key, data)


def _content(path: Path) -> bytes | None:
    try:
        return path.read_bytes() if path.is_file() else None
    except OSError as e:
        remedy = (
            f"Make it readable for yourself, as with `chmod u+rx {quote(str(path.parent))}` "
            f"and `chmod u+r {quote(str(path))}`."
        )
        what = f"cannot be read ({e.strerror or e})."
        rule = FILE_RULES.get(path.name, "V-02")  # a reward function may have any name
        raise ProblemsError([Problem(rule, "error", str(path), None, what, remedy)]) from e
