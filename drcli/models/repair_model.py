"""Checks and repairs the small objects of a model before a command relies on them.

It also repairs what `drcli.store.repair` does not know: the parameter files and the run's metadata.
"""

import re
from collections.abc import Callable

from drcli.base import notices
from drcli.base.errors import SettingsError
from drcli.config.settings import ModelConfig
from drcli.exchange.training_start import TrainingStart
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata
from drcli.models.run_metadata import read_start
from drcli.store import keys, lease
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing
from drcli.store.reconstruct import readable_records
from drcli.store.repair import Model, damages, repair, set_aside

_SEED = re.compile(rb'"seed": ?(\d{1,15})\b')


def look_after(
    config: ModelConfig,
    bucket: Bucket,
    prefix: str,
    *,
    may_write: bool = True,
    missing: bool = False,
) -> None:
    """Tell what is damaged of a model, and repair it where nobody trains it.

    Args:
        config: The model of the settings, whose metrics may lie elsewhere.
        bucket: Holds the model.
        prefix: The model.
        may_write: Whether the command may change something.
        missing: Whether a pointer to a checkpoint that does not exist counts as damaged.
    """
    held = lease.holder(bucket, prefix)
    trained = held is not None and lease.is_owner_alive(held)
    model = Model.of(config, bucket, prefix)
    told = repair_all(model, missing=missing) if may_write and not trained else damages(model)
    for sentence in told:
        notices.warn(sentence)


def repair_all(model: Model, *, missing: bool = True) -> list[str]:
    """Put every damaged object of a model aside and reconstruct it; only while nobody trains it.

    Args:
        model: Which.
        missing: Whether a pointer to a checkpoint that does not exist counts as damaged.

    Returns:
        What was damaged and what became of it, a sentence each.
    """
    return [
        *repair(model, missing=missing),
        *_repair_parameters(model),
        *_repair_start(model),
    ]


def _repair_parameters(model: Model) -> list[str]:
    """Bring back the model's copies of the parameter files, which each checkpoint carries."""
    checks: list[tuple[str, str, Callable[[bytes, str], object]]] = [
        (
            keys.hyperparameters(model.prefix),
            keys.HYPERPARAMETERS_FILE,
            Hyperparameters.from_bytes,
        ),
        (keys.model_metadata(model.prefix), keys.MODEL_METADATA_FILE, ModelMetadata.from_bytes),
    ]
    told = []
    for key, name, check in checks:
        try:
            check(model.bucket.get(key), f"{model.bucket.name}/{key}")
        except ObjectMissing:
            continue
        except SettingsError as error:
            saved = _saved(model, name)
            try:
                check(saved, name)
            except SettingsError:
                continue  # the command that needs the file tells what is wrong with it
            kept = set_aside(model.bucket, model.prefix, key)
            model.bucket.put(key, saved)
            told.append(
                f"{error} It was brought back from a checkpoint. The damaged one is kept as "
                f"{model.bucket.name}/{kept}."
            )
    return told


def _saved(model: Model, name: str) -> bytes:
    """The copy of a parameter file in the newest checkpoint, empty where there is none."""
    for record in reversed(readable_records(model.bucket, model.prefix)):
        text = record.counters.inputs.get(name)
        if text is not None:
            return text.encode()
    return b""


def _repair_start(model: Model) -> list[str]:
    """Keep the seed at least, which a training goes on with."""
    bucket, key = model.bucket, keys.training_start(model.prefix)
    try:
        read_start(bucket, model.prefix)
    except ObjectDamaged as error:
        found = _SEED.search(bucket.get(key))
        seeds = [record.counters.seed for record in readable_records(bucket, model.prefix)]
        seed = next((s for s in reversed(seeds) if s is not None), None)
        if seed is None and found is not None:
            seed = int(found[1])
        kept = set_aside(bucket, model.prefix, key)
        became = "Its seed is lost; the training goes on with a new one."
        if seed is not None:
            bucket.put(key, TrainingStart(seed).encode())
            became = f"Its seed, {seed}, was brought back."
        return [f"{error} {became} The damaged one is kept as {bucket.name}/{kept}."]
    return []
