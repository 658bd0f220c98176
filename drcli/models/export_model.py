"""Reads the checkpoint of a model that is to be exported."""

from dataclasses import dataclass

from drcli.base import notices
from drcli.base.errors import SettingsError
from drcli.base.replaceable import safe_name
from drcli.config.checkpoint_words import CheckpointChoice
from drcli.config.settings import Settings, catalogue
from drcli.exchange.checkpoint import CheckpointRecord
from drcli.formats.stored_checkpoint import load_checkpoint
from drcli.modelfiles.network_shape import Design
from drcli.models.checkpoint_choice import (
    OUR_PARTS,
    CheckpointGone,
    Chosen,
    find_choice,
    sentence_about,
)
from drcli.models.checkpoint_files import known_best
from drcli.models.repair_model import repair_or_warn
from drcli.models.run_metadata import read_start
from drcli.models.transfer_buckets import checked_prefix
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, ObjectNewer
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.store.repair import Model

_WORLD = "DR_WORLD_NAME"

_PICKS = 5
"""A training may delete the last checkpoint."""


@dataclass(frozen=True)
class Selection:
    choice: CheckpointChoice = "best"
    prefix: str | None = None


@dataclass(frozen=True)
class ExportSource:
    """A checkpoint that was trained or imported here.

    Attributes:
        weights: Safetensors.
        graph: The reference's frozen graph; None for ours.
    """

    bucket: str
    prefix: str
    chosen: Chosen
    design: Design
    weights: bytes
    origin: str
    world: str | None = None
    best: str | None = None
    graph: bytes | None = None

    @property
    def url(self) -> str:
        return f"s3://{self.bucket}/{self.prefix}"

    @property
    def file_name(self) -> str:
        return safe_name(self.prefix)


def read_export_source(settings: Settings, selection: Selection) -> ExportSource:
    """Read from our own bucket, even during a training.

    Raises:
        SettingsError: Model, checkpoint or parameters cannot be used.
        StorageError: The bucket cannot be read, or the checkpoint is damaged.
    """
    prefix = selection.prefix
    prefix = checked_prefix(prefix, "-p") if prefix else settings.model_prefix
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    repair_or_warn(settings.model, bucket, prefix)
    model = Model.of(settings.model, bucket, prefix)
    for attempt in range(_PICKS):
        chosen = find_choice(model, selection.choice)
        try:
            found = load_checkpoint(bucket, prefix, chosen.name)
        except ObjectMissing as e:
            if attempt == _PICKS - 1 or isinstance(selection.choice, int):
                raise CheckpointGone(
                    f"No model files found. Files possibly deleted. Try again. {e}",
                    remedy="Run the command again, or choose another checkpoint.",
                ) from e
            continue
        break
    notices.show(sentence_about(model, chosen))
    weights_part = next(part for part in (*OUR_PARTS, ".index") if part in chosen.parts)
    key = keys.checkpoint_part(prefix, chosen.name, weights_part)
    graph = keys.checkpoint_graph(prefix, chosen.number)
    has_graph = weights_part == ".index" and bucket.exists(graph)
    return ExportSource(
        bucket.name,
        prefix,
        chosen,
        _design(bucket, prefix, found.record),
        found.tensors,
        f"s3://{bucket.name}/{key}",
        _world(bucket, prefix),
        known_best(bucket, prefix),
        bucket.get(graph) if has_graph else None,
    )


def _design(bucket: Bucket, prefix: str, record: CheckpointRecord) -> Design:
    try:
        return Design.of_record(bucket, prefix, record)
    except ObjectMissing as e:
        raise SettingsError(
            f"Meta-data files are not found. Exiting. {e}",
            remedy="Restore that file from a copy, or choose another model with -p "
            "(`dr-list-models` lists all models).",
        ) from e


def _world(bucket: Bucket, prefix: str) -> str | None:
    try:
        start = read_start(bucket, prefix)
    except (ObjectDamaged, ObjectNewer):
        return None
    if start is None or start.settings is None:
        return None
    world = start.settings.get(_WORLD, catalogue()[_WORLD].default)
    return world if isinstance(world, str) else None
