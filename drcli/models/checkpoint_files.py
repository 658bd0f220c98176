"""The files that belong to a checkpoint: reward function, parameters, metrics."""

from drcli.base import notices
from drcli.base.errors import SettingsError
from drcli.config.settings import ModelConfig
from drcli.modelfiles.params_yaml import moved_training_parameters
from drcli.models.checkpoint_choice import Item
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged

METADATA = "model/" + keys.MODEL_METADATA_FILE
HYPERPARAMETERS = "ip/" + keys.HYPERPARAMETERS_FILE
METRICS = "metrics/"
NOTE = "ip/run.json"

SHAPING = (METADATA, HYPERPARAMETERS)
"""Without the right ones of these, weights cannot be read."""

PARAMETERS_FILE = "training_params.yaml"
"""What import tools look for, whatever the training called it."""


def refuse_incomplete(model: ModelConfig, bucket: Bucket, prefix: str) -> None:
    """Check that a model has everything that belongs to it.

    Raises:
        SettingsError: It has not.
    """
    missing = [name for name, found in _places(model, bucket, prefix).items() if not found]
    if missing and not bucket.list(keys.folder(prefix)):
        raise SettingsError(
            "Meta-data files are not found. Exiting. There is no model at "
            f"s3://{bucket.name}/{prefix}.",
            remedy="Correct its name (DR_LOCAL_S3_MODEL_PREFIX, or -p); `dr-list-models` shows "
            "all there are.",
        )
    if missing:
        raise SettingsError(
            f"Meta-data files are not found. Exiting. s3://{bucket.name}/{prefix} lacks "
            f"{', '.join(missing)}.",
            remedy="If it is being trained, wait for its first iteration; else name another one "
            "with -p (`dr-list-models` shows all).",
        )


def read_model_files(
    model: ModelConfig, bucket: Bucket, prefix: str, target: tuple[str, str], described: bytes
) -> list[Item]:
    """Read everything that belongs to a checkpoint.

    Args:
        model: The model of the settings, for files that are elsewhere than below the prefix.
        bucket: Holds the model.
        prefix: The model.
        target: Bucket and prefix of the copy, which its parameter file names.
        described: The parameter file to copy if the model has none.

    Raises:
        StorageError: Something cannot be read.
    """
    items: dict[str, Item] = {}
    for kind, found in _places(model, bucket, prefix).items():
        for key in found:
            name = kind
            if kind == METRICS:
                name += key.removeprefix(_metrics_folder(model, prefix, key))
            items[name] = Item(name, bucket.get(key))
            if kind != METRICS and not items[name].data:
                raise ObjectDamaged(
                    f"s3://{bucket.name}/{key} is empty.",
                    remedy="Restore it from a copy, or upload another model with -p.",
                )
    root = keys.MODEL_METADATA_FILE
    items[root] = Item(root, items[METADATA].data)
    if bucket.exists(keys.training_start(prefix)):
        items[NOTE] = Item(NOTE, bucket.get(keys.training_start(prefix)))
    parameters = _parameters(model, bucket, prefix, target, described)
    items[PARAMETERS_FILE] = Item(PARAMETERS_FILE, parameters)
    return list(items.values())


def _places(model: ModelConfig, bucket: Bucket, prefix: str) -> dict[str, list[str]]:
    """Keys of each kind of file that must be there; empty where it is missing."""
    rewards = [keys.reward_function(prefix)]
    if prefix == model.prefix:
        rewards.append(model.reward_key)
    return {
        keys.REWARD_FUNCTION_FILE: _existing(bucket, rewards)[:1],
        METADATA: _existing(bucket, [keys.model_metadata(prefix)]),
        HYPERPARAMETERS: _existing(bucket, [keys.hyperparameters(prefix)]),
        METRICS: [
            info.key for folder in _metrics_folders(model, prefix) for info in bucket.list(folder)
        ],
    }


def _existing(bucket: Bucket, wanted: list[str]) -> list[str]:
    return [key for key in wanted if bucket.exists(key)]


def _metrics_folders(model: ModelConfig, prefix: str) -> list[str]:
    """The usual place, and the one of the settings if these are of this model."""
    folders = [keys.folder(keys.metrics_prefix(prefix))]
    if prefix == model.prefix:
        folders.append(keys.folder(model.metrics_prefix))
    return list(dict.fromkeys(folders))


def _metrics_folder(model: ModelConfig, prefix: str, key: str) -> str:
    return next(f for f in _metrics_folders(model, prefix) if key.startswith(f))


def _parameters(
    model: ModelConfig, bucket: Bucket, prefix: str, target: tuple[str, str], described: bytes
) -> bytes:
    """What the model was trained with, for its new place; from the settings where it is unknown."""
    key = keys.parameter_file(prefix, model.parameters_file)
    written = bucket.get(key) if bucket.exists(key) else described
    try:
        return moved_training_parameters(written, *target)
    except ValueError as e:
        notices.warn(f"{bucket.name}/{key} is damaged: {e}. The copy is made from the settings.")
        return moved_training_parameters(described, *target)
