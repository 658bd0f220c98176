"""Reads the checkpoint of a model that is to be exported."""

import contextlib
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drcli.base import errors
from drcli.base.errors import SettingsError, shown
from drcli.base.files import hand_out, make_folder, remedy_for, rewrite, safe_name
from drcli.bucket.bucket import Bucket, ObjectDamaged, ObjectMissing, ObjectNewer
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.run_config import DriveConfig
from drcli.config.settings import Settings
from drcli.config.value_types import CheckpointChoice
from drcli.convert.stored_checkpoint import load_checkpoint
from drcli.model import keys
from drcli.model.checkpoint_choice import (
    OUR_PARTS,
    CheckpointGone,
    Chosen,
    ModelCheckpoints,
)
from drcli.model.checkpoint_list import Item
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.network_shape import Design
from drcli.model.model_store import ModelStore
from drcli.model.repair import repair_unless_trained
from drcli.model.run_metadata import read_start
from drcli.model.write_probe import prove_writing
from drcli.records.checkpoint import CheckpointRecord
from drcli.records.scores import NOT_EVALUATED, Score, encode_single
from drcli.transfer.put_model import POINTERS, Delivery, Progress
from drcli.transfer.transfer_buckets import (
    COPY_PATIENCE_S,
    checked_prefix,
    parse_url,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
    source_bucket,
)

_WORLD = "DR_WORLD_NAME"
_DRIVEN = (
    _WORLD,
    "DR_TRAIN_WORLDS",
    "DR_TRAIN_REVERSE_DIRECTION",
    "DR_TRAIN_ALTERNATE_DRIVING_DIRECTION",
)

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
        driven: Settings of its training that say where it drove, by name, of each worker.
        notes: For the racer.
    """

    bucket: str
    prefix: str
    chosen: Chosen
    design: Design
    weights: bytes
    origin: str
    driven: Sequence[Mapping[str, Any]] = ({},)
    best: str | None = None
    graph: bytes | None = None
    notes: tuple[str, ...] = ()

    @property
    def url(self) -> str:
        return f"s3://{self.bucket}/{self.prefix}"

    def with_network(self, design: Design, weights: bytes, note: str) -> "ExportSource":
        """With another network, which learned from this one."""
        score = replace(self.chosen.score, avg_eval_metric=None, episodes=None)
        chosen = replace(self.chosen, score=score)
        return replace(
            self, chosen=chosen, design=design, weights=weights, graph=None, notes=(note,)
        )

    @property
    def file_name(self) -> str:
        return safe_name(self.prefix)

    @property
    def world(self) -> str | None:
        world: str | None = self.driven[0].get(_WORLD)
        return world

    def races(self, settings: Settings) -> list[DriveConfig]:
        """That of the settings, where each worker trained the model."""
        fields = DriveConfig.declared
        return [
            settings.race.replaced(**{fields[name].field: value for name, value in driven.items()})
            for driven in self.driven
        ]


Prepare = Callable[[ExportSource], ExportSource]
"""What an export does to a model before; it may take minutes."""


def unchanged(source: ExportSource) -> ExportSource:
    return source


def read_export_source(settings: Settings, selection: Selection) -> ExportSource:
    """Read from our own bucket, even during a training.

    Raises:
        SettingsError: ModelStore, checkpoint or parameters cannot be used.
        StorageError: The bucket cannot be read, or the checkpoint is damaged.
    """
    prefix = selection.prefix
    prefix = checked_prefix(prefix, "-p") if prefix else settings.model_prefix
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    store = ModelStore(bucket, prefix)
    model = ModelStore.of(settings.model, bucket, prefix)
    repair_unless_trained(model)
    for attempt in range(_PICKS):
        checkpoints = ModelCheckpoints.read(model)
        chosen = checkpoints.choose(selection.choice)
        try:
            found = load_checkpoint(store, chosen.name)
        except ObjectMissing as e:
            if attempt == _PICKS - 1 or isinstance(selection.choice, int):
                raise CheckpointGone(
                    str(e),
                    remedy="Run the command again, or choose another checkpoint.",
                ) from e
            continue
        break
    errors.show(checkpoints.sentence_about(chosen))
    weights_part = next(part for part in (*OUR_PARTS, ".index") if part in chosen.parts)
    key = keys.checkpoint_part(prefix, chosen.name, weights_part)
    graph = keys.checkpoint_graph(prefix, chosen.number)
    has_graph = weights_part == ".index" and bucket.exists(graph)
    return ExportSource(
        bucket.name,
        prefix,
        chosen,
        _design(store, found.record),
        found.tensors,
        f"s3://{bucket.name}/{key}",
        _driven(store),
        CheckpointStore(store).best_name(),
        bucket.get(graph) if has_graph else None,
    )


def _design(model: ModelStore, record: CheckpointRecord) -> Design:
    try:
        return Design.of_record(model, record)
    except ObjectMissing as e:
        raise SettingsError(
            f"Meta-data files are not found. Exiting. {e}",
            remedy="Restore that file from a copy, or choose another model with -p "
            "(`dr-list-models` lists all models).",
        ) from e


def _driven(model: ModelStore) -> list[Mapping[str, Any]]:
    try:
        start = read_start(model)
    except (ObjectDamaged, ObjectNewer):
        return [{}]
    if start is None or start.settings is None:
        return [{}]
    first = {name: DriveConfig.declared[name].default for name in _DRIVEN} | start.settings
    return [_known(first | own) for own in ({}, *start.workers)]


def _known(settings: Mapping[str, Any]) -> dict[str, Any]:
    fields = DriveConfig.declared
    return {n: settings[n] for n in _DRIVEN if type(settings[n]) is type(fields[n].default)}


# Writes an export so that nobody finds a part of it.


_URL = "s3://"


@dataclass(frozen=True)
class ExportTarget:
    shown: str
    folder: Path | None = None
    bucket: Bucket | None = None
    prefix: str = ""


def is_url(out: str) -> bool:
    return out.casefold().startswith(_URL)


def export_target(
    settings: Settings, out: str, source: str, *, local: bool, force: bool
) -> ExportTarget:
    """Check where an export should go, at most with a test object.

    Raises:
        SettingsError: The place cannot be used.
        StorageError: The bucket cannot be reached.
    """
    if not is_url(out):
        return ExportTarget(
            out, folder=_usable_folder(Path(out).expanduser().resolve(), force=force)
        )
    name, prefix = parse_url(out, "--out")
    bucket = source_bucket(settings.transfer, name, local=local, patience_s=COPY_PATIENCE_S)
    model = ModelStore(bucket, prefix)
    there = bucket.list(keys.folder(prefix))
    here = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    refuse_overlap((here, source), (bucket, prefix), flag="--out", may_write=True)
    if local:
        refuse_nesting(model, settings.custom_files_prefix, flag="--out")
    refuse_training(model)
    if there and not force:
        raise SettingsError(
            f"{out} is not empty: it has {there[0].key.removeprefix(keys.folder(prefix))}.",
            remedy="Choose another prefix with --out, or replace the files there with -f "
            "(--force).",
        )
    prove_writing(model, deletes=force)
    return ExportTarget(f"{_URL}{name}/{prefix}", bucket=bucket, prefix=prefix)


def write_items(
    target: ExportTarget, items: Sequence[Item], score: Score, progress: Progress
) -> None:
    """The two pointers come last; raises DrError."""
    pointers = pointer_items(score)
    if target.folder is not None:
        _write_folder(target.folder, [*items, *pointers])
    elif target.bucket is not None:
        with progress("Uploading export", sum(len(item.data) for item in items)) as watch:
            delivery = Delivery(ModelStore(target.bucket, target.prefix), watch)
            if any(map(delivery.differs, items)):
                delivery.withdraw()  # the files there are of another model or checkpoint
            delivery.send(items)
            delivery.publish(score)


def pointer_items(score: Score) -> list[Item]:
    contents = (score.name.encode(), encode_single(score))
    return [Item(name, data) for name, data in zip(POINTERS, contents, strict=True)]


def reference_score(score: Score) -> Score:
    metric = NOT_EVALUATED if score.avg_eval_metric is None else score.avg_eval_metric
    return replace(score, avg_eval_metric=metric, episodes=None)


def write_archive(path: Path, data: bytes) -> None:
    """In one step, with its folder if needed."""
    try:
        make_folder(path.parent)
    except OSError as e:
        raise _unwritable(path.parent, e) from e
    rewrite(path, data)


def _usable_folder(folder: Path, *, force: bool) -> Path:
    try:
        if folder.exists() and not folder.is_dir():
            raise SettingsError(
                f"--out {shown(str(folder))} is a file.", remedy="Name a folder with --out."
            )
        if folder.is_dir() and any(folder.iterdir()) and not force:
            raise SettingsError(
                f"--out {shown(str(folder))} is not empty.",
                remedy="Choose another folder with --out, or replace the files there with -f "
                "(--force).",
            )
    except OSError as e:
        raise _unwritable(folder, e) from e
    return folder


def _write_folder(folder: Path, items: Sequence[Item]) -> None:
    try:
        if folder.is_dir() and any(folder.iterdir()):
            # Without pointers, nobody takes new files for those of the old checkpoint.
            for name in reversed(POINTERS):
                (folder / name).unlink(missing_ok=True)
            _write_files(folder, items)
            return
        make_folder(folder.parent)
        scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            hand_out(scratch)
            _write_files(scratch, items)
            scratch.replace(folder)  # also onto an empty folder
        except BaseException:
            with contextlib.suppress(OSError):
                shutil.rmtree(scratch)
            raise
    except OSError as e:
        raise _unwritable(folder, e) from e


def _write_files(folder: Path, items: Sequence[Item]) -> None:
    for item in items:
        path = folder / item.name
        make_folder(path.parent)
        rewrite(path, item.data)


def _unwritable(folder: Path, error: OSError) -> SettingsError:
    return SettingsError(
        f"--out {shown(str(folder))}: cannot be written ({error.strerror or error}).",
        remedy=remedy_for(error, folder, f"Check that you can write {folder.parent}."),
    )
