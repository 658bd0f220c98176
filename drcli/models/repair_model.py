"""Checks and repairs a model's small objects before a command relies on them."""

import re
from collections.abc import Callable

from drcli.base import notices
from drcli.base.errors import SettingsError
from drcli.config.bucket_config import ModelConfig
from drcli.exchange.training_start import TrainingStart
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata
from drcli.models.run_metadata import read_start
from drcli.store import keys, lease
from drcli.store.bucket import Bucket, ObjectDamaged
from drcli.store.model_kind import model_kind
from drcli.store.reconstruct import readable_records
from drcli.store.repair import Model, find_damage, repair, set_aside

_SEED = re.compile(rb'"seed": ?(\d{1,15})\b')


def repair_or_warn(
    config: ModelConfig,
    bucket: Bucket,
    prefix: str,
    *,
    may_write: bool = True,
    missing: bool = False,
) -> None:
    """Repairs only while nobody trains; `missing`: a pointer to no checkpoint counts."""
    model = Model.of(config, bucket, prefix)
    may_repair = may_write and lease.live_holder(bucket, prefix) is None
    sentences = repair_all(model, missing=missing) if may_repair else find_damage(model)
    for sentence in sentences:
        notices.warn(sentence)


def repair_all(model: Model, *, missing: bool = True) -> list[str]:
    """Set damage aside and reconstruct it, with a sentence each; only while nobody trains.

    Not in a model of the reference, whose checkpoints do not help.
    """
    if model_kind(model.bucket, model.prefix) == "tensorflow":
        return []
    return [*repair(model, missing=missing), *_restore_parameters(model), *_repair_start(model)]


def _restore_parameters(model: Model) -> list[str]:
    """From a checkpoint, which has copies; only for the owner."""
    checks: list[tuple[str, str, Callable[[bytes, str], object]]] = [
        (
            keys.hyperparameters(model.prefix),
            keys.HYPERPARAMETERS_FILE,
            Hyperparameters.from_bytes,
        ),
        (keys.model_metadata(model.prefix), keys.MODEL_METADATA_FILE, ModelMetadata.from_bytes),
    ]
    sentences = []
    for key, name, check in checks:
        damaged = model.bucket.get(key) if model.bucket.exists(key) else None
        reason = f"{model.bucket.name}/{key} is missing."
        if damaged is not None:
            try:
                check(damaged, f"{model.bucket.name}/{key}")
                continue
            except SettingsError as error:
                reason = str(error)
        records = reversed(readable_records(model.bucket, model.prefix))
        saved = next((r.counters.inputs[name] for r in records if name in r.counters.inputs), "")
        try:
            check(saved.encode(), name)
        except SettingsError:
            continue  # the command that needs the file says what is wrong with it
        kept = set_aside(model.bucket, model.prefix, key) if damaged is not None else None
        model.bucket.put(key, saved.encode())
        also = f" The damaged one is kept as {model.bucket.name}/{kept}." if kept else ""
        sentences.append(f"{reason} It was restored from a checkpoint.{also}")
    return sentences


def _repair_start(model: Model) -> list[str]:
    """Keep at least the seed: resuming needs it."""
    bucket, key = model.bucket, keys.training_start(model.prefix)
    try:
        read_start(bucket, model.prefix)
    except ObjectDamaged as error:
        found = _SEED.search(bucket.get(key))
        seeds = [record.counters.seed for record in readable_records(bucket, model.prefix)]
        seed = next((s for s in reversed(seeds) if s is not None), int(found[1]) if found else None)
        kept = set_aside(bucket, model.prefix, key)
        became = "Its seed is lost; the training continues with a new one."
        if seed is not None:
            bucket.put(key, TrainingStart(seed).encode())
            became = f"Its seed, {seed}, was restored."
        return [f"{error} {became} The damaged one is kept as {bucket.name}/{kept}."]
    return []
