"""Reads a checkpoint with all files that belong to it."""

from dataclasses import dataclass, replace

from drcli.base import notices
from drcli.base.errors import SettingsError
from drcli.config.bucket_config import ModelConfig
from drcli.modelfiles.network_shape import own_files
from drcli.modelfiles.params_yaml import moved_training_parameters
from drcli.models.checkpoint_choice import OUR_PARTS, Chosen
from drcli.store import keys
from drcli.store.best_checkpoint import read_scores
from drcli.store.bucket import Bucket, ObjectDamaged
from drcli.store.checkpoints import CheckpointStore
from drcli.store.complete_files import read_complete

METADATA = "model/" + keys.MODEL_METADATA_FILE
HYPERPARAMETERS = "ip/" + keys.HYPERPARAMETERS_FILE
METRICS = "metrics/"
TRAINING_START = "ip/run.json"

SHAPING = (METADATA, HYPERPARAMETERS)
"""The weights can only be read with the network's shape in these."""

PARAMETERS_FILE = "training_params.yaml"


@dataclass(frozen=True)
class Item:
    name: str
    data: bytes


def known_best(bucket: Bucket, prefix: str) -> str | None:
    try:
        scores = read_scores(bucket, prefix)
    except ObjectDamaged:
        return None
    return None if scores is None else scores.best_checkpoint.name


def read_checkpoint(bucket: Bucket, prefix: str, chosen: Chosen) -> list[Item]:
    """Read a checkpoint, without an unusable optimizer state; ours are checked.

    Raises:
        ObjectMissing: A file has just been deleted.
        ObjectDamaged: A file is not what was written.
    """
    start = f"model/{chosen.name}"
    items = []
    if all(part in chosen.parts for part in OUR_PARTS):
        found = CheckpointStore(bucket, prefix).load(chosen.name, with_optimizer=True)
        record = found.record if found.optimizer else replace(found.record, optimizer=None)
        items.append(Item(f"{start}.safetensors", found.tensors))
        if found.optimizer is not None:
            items.append(Item(f"{start}.optimizer.safetensors", found.optimizer))
        items.append(Item(f"{start}.json", record.encode()))
    theirs = [part for part in keys.TENSORFLOW_PARTS if part in chosen.parts]
    items += [_filled(bucket, prefix, start + part) for part in theirs]
    graph = keys.checkpoint_graph(prefix, chosen.number)
    if bucket.exists(graph):
        items.append(_filled(bucket, prefix, graph.removeprefix(keys.folder(prefix))))
    return items


def refuse_incomplete(model: ModelConfig, bucket: Bucket, prefix: str) -> None:
    """Raise SettingsError if shared files are missing."""
    _, missing = _shared_files(model, bucket, prefix)
    if missing and not bucket.list(keys.folder(prefix)):
        raise SettingsError(
            "Meta-data files are not found. Exiting. There is no model at "
            f"s3://{bucket.name}/{prefix}.",
            remedy="Correct its name (DR_LOCAL_S3_MODEL_PREFIX, or -p); `dr-list-models` lists "
            "all models.",
        )
    if missing:
        raise SettingsError(
            f"Meta-data files are not found. Exiting. s3://{bucket.name}/{prefix} lacks "
            f"{', '.join(missing)}.",
            remedy="If it is being trained, wait for its first iteration; otherwise choose another "
            "model with -p (`dr-list-models` lists all models).",
        )


def read_model_files(
    model: ModelConfig,
    bucket: Bucket,
    prefix: str,
    checkpoint: str,
    target: tuple[str, str],
    described: bytes,
) -> list[Item]:
    """Read the shared files for a copy at `target`; `described` is for a missing parameter file."""
    found, _ = _shared_files(model, bucket, prefix)
    items = {name: Item(name, read_complete(bucket, key)) for name, key in found.items()}
    for name, item in items.items():
        if not item.data and not name.startswith(METRICS):
            raise ObjectDamaged(
                f"s3://{bucket.name}/{found[name]} is empty.",
                remedy="Restore it from a copy, or upload another model with -p.",
            )
    own = own_files(bucket, prefix, checkpoint)
    for name in SHAPING:
        items[name] = Item(name, own[name.rpartition("/")[2]])
    copies = [Item(keys.MODEL_METADATA_FILE, items[METADATA].data)]
    if bucket.exists(keys.training_start(prefix)):
        copies.append(Item(TRAINING_START, bucket.get(keys.training_start(prefix))))
    for info in bucket.list(keys.notes_folder(prefix)):
        name = info.key.removeprefix(keys.folder(prefix))
        copies.append(Item(name, bucket.get(info.key)))
    parameters = _parameters(model, bucket, prefix, target, described)
    return [*items.values(), *copies, Item(PARAMETERS_FILE, parameters)]


def _filled(bucket: Bucket, prefix: str, name: str) -> Item:
    data = bucket.get(keys.folder(prefix) + name)
    if not data:
        raise ObjectDamaged(
            f"{bucket.name}/{keys.folder(prefix)}{name} is empty.",
            remedy="Restore it from a copy, or choose another checkpoint.",
        )
    return Item(name, data)


def _shared_files(
    model: ModelConfig, bucket: Bucket, prefix: str
) -> tuple[dict[str, str], list[str]]:
    rewards = [keys.reward_function(prefix)]
    folders = [keys.folder(keys.metrics_prefix(prefix))]
    if prefix == model.prefix:
        rewards.append(model.reward_key)
        folders.append(keys.folder(model.metrics_prefix))
    wanted = {
        keys.REWARD_FUNCTION_FILE: rewards,
        METADATA: [keys.model_metadata(prefix)],
        HYPERPARAMETERS: [keys.hyperparameters(prefix)],
    }
    found = {}
    for name, places in wanted.items():
        key = next(filter(bucket.exists, places), None)
        if key is not None:
            found[name] = key
    metrics = {
        METRICS + info.key.removeprefix(folder): info.key
        for folder in dict.fromkeys(folders)
        for info in bucket.list(folder)
        if not keys.is_part(info.key)  # of a file that grows, which is copied as a whole
    }
    missing = [name for name in wanted if name not in found]
    return found | metrics, missing if metrics else [*missing, METRICS]


def _parameters(
    model: ModelConfig, bucket: Bucket, prefix: str, target: tuple[str, str], described: bytes
) -> bytes:
    key = keys.parameter_file(prefix, model.parameters_file)
    written = bucket.get(key) if bucket.exists(key) else described
    try:
        return moved_training_parameters(written, *target)
    except ValueError as e:
        notices.warn(f"{bucket.name}/{key} is damaged: {e}. The copy is made from the settings.")
        return moved_training_parameters(described, *target)
