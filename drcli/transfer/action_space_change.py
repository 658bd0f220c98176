"""Puts other actions into a model_metadata.json, and tells what that means."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drcli.base.errors import DrError, ProblemsError, SettingsError, few
from drcli.bucket.bucket import Bucket
from drcli.config.presets import model_file
from drcli.config.settings import Settings
from drcli.learn.algorithms import algorithm_named
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore, checkpoint_objects
from drcli.model.files.action_choice import ChosenAction
from drcli.model.files.action_space import ActionSpace
from drcli.model.files.custom_files import local_file
from drcli.model.files.data_file import read_json_object
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import own_files
from drcli.model.model_store import ModelStore
from drcli.transfer.copy_custom_files import BACKUP, write_file


@dataclass(frozen=True)
class ActionSpaceChange:
    file: Path
    data: bytes
    before: ActionSpace | None
    after: ActionSpace
    warnings: tuple[str, ...]

    @property
    def backup(self) -> Path | None:
        return None if self.before is None else self.file.with_name(self.file.name + BACKUP)


@dataclass(frozen=True)
class ActionSpaceReport:
    """Actions, and what was done with them.

    Attributes:
        file: The model_metadata.json.
        actions: The discrete actions; empty if continuous.
        low: Least steering and speed; None if discrete.
        high: Greatest steering and speed; None if discrete.
        notes: Where they come from, and what may surprise.
        changes: Whether the file has other actions.
        written: Whether they were written into it.
        backup: The copy of the old file; None without one.
        picture: The picture; None without one.
    """

    file: str
    actions: tuple[ChosenAction, ...]
    low: tuple[float, float] | None
    high: tuple[float, float] | None
    notes: tuple[str, ...]
    changes: bool
    written: bool = False
    backup: str | None = None
    picture: str | None = None


def space_of(file: Path) -> ActionSpace:
    """The actions in a file.

    Raises:
        SettingsError: It is missing.
        ProblemsError: It is wrong.
    """
    found = local_file(file.parent, file.name)
    if found is None:
        raise SettingsError(
            f"{file} is missing.",
            remedy="Create a working folder with `dr init`, or name another file with --file.",
        )
    return ModelMetadata.from_bytes(found.data, str(file)).action_space


def plan_change(file: Path, actions: list[dict[str, float]] | dict[str, Any]) -> ActionSpaceChange:
    """Work out a file with other actions, all else unchanged.

    A missing file becomes the shipped one.

    Raises:
        SettingsError: Its algorithm cannot have such actions.
        ProblemsError: The file is or would be wrong.
    """
    found = local_file(file.parent, file.name)
    data = model_file(keys.MODEL_METADATA_FILE).read_bytes() if found is None else found.data
    values = dict(read_json_object(data, str(file), "V-30").values)
    discrete = isinstance(actions, list)
    algorithm = algorithm_named(values.get("training_algorithm"))
    if discrete and algorithm.ranges_only:
        raise SettingsError(
            f"{file}: training_algorithm={algorithm.name} needs continuous actions, not a list.",
            remedy='Use `dr-action-space generate --continuous`, or write "training_algorithm": '
            '"clipped_ppo".',
        )
    values["action_space"] = actions
    values["action_space_type"] = "discrete" if discrete else "continuous"
    new = metadata_text(values).encode()
    after = ModelMetadata.from_bytes(new, str(file))
    before = None
    if found is not None:
        try:
            before = ModelMetadata.from_bytes(found.data, str(file)).action_space
        except ProblemsError:
            before = ActionSpace()  # its actions were wrong, and are replaced
    warnings = tuple(few(str(each) for each in after.problems))
    return ActionSpaceChange(file, new, before, after.action_space, warnings)


def trained_with(settings: Settings, bucket: Bucket) -> tuple[int, ActionSpace | None]:
    prefix = settings.model_prefix
    model = ModelStore(bucket, prefix)
    count = len(set(checkpoint_objects(model).values()))
    if not count:
        return 0, None
    try:
        newest = str(CheckpointStore(model).pointed())
        data = own_files(model, newest)[keys.MODEL_METADATA_FILE]
        return count, ModelMetadata.from_bytes(data, keys.model_metadata(prefix)).action_space
    except (KeyError, DrError):
        return count, None


def sentence_about(
    model: str, checkpoints: int, trained: ActionSpace | None, new: ActionSpace
) -> str:
    """What new actions mean for a trained model, or nothing."""
    if not checkpoints or trained == new:
        return ""
    has = f"{model} has {checkpoints} checkpoint{'s' if checkpoints > 1 else ''}"
    another = "Give DR_LOCAL_S3_MODEL_PREFIX another name before you train with the new ones."
    if trained is None:
        return f"{has}, and its own actions cannot be read. {another}"
    if (trained.continuous, trained.num_actions) != (new.continuous, new.num_actions):
        return (
            f"{has}, trained with {_called(trained)}; with {_called(new)} its training "
            f"cannot go on. {another}"
        )
    return f"{has}, trained with {_called(trained)} of other values. {another}"


def write_change(change: ActionSpaceChange) -> bool:
    """Write the file, and keep the old one as .bak; False if nothing changes.

    Raises:
        SettingsError: It cannot be written.
    """
    if change.before == change.after:
        return False
    return write_file(change.file, change.data)


def _called(space: ActionSpace) -> str:
    if space.continuous:
        return "continuous actions"
    return f"{space.num_actions} action{'s' if space.num_actions != 1 else ''}"


def with_metadata(data: bytes, name: str, changes: Mapping[str, Any]) -> bytes:
    """A model_metadata.json with other values for some keys; None removes a key.

    Raises:
        ProblemsError: The file is or would be wrong.
    """
    values = {**read_json_object(data, name, "V-30").values, **changes}
    kept = {key: value for key, value in values.items() if value is not None}
    new = metadata_text(kept).encode()
    ModelMetadata.from_bytes(new, name)
    return new


def metadata_text(values: dict[str, Any]) -> str:
    parts = []
    for key, value in values.items():
        parts.append(f"  {json.dumps(key)}: {_indented(key, value)}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _indented(key: str, value: Any) -> str:
    if key == "action_space" and isinstance(value, list):
        return "[\n" + ",\n".join(f"    {json.dumps(each)}" for each in value) + "\n  ]"
    if key == "action_space" and isinstance(value, dict):
        inside = (f"    {json.dumps(name)}: {json.dumps(each)}" for name, each in value.items())
        return "{\n" + ",\n".join(inside) + "\n  }"
    return json.dumps(value, ensure_ascii=False)
