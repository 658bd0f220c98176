"""A model in another bucket, where a training may change it."""

from contextlib import suppress
from dataclasses import dataclass

from drcli.base import errors
from drcli.base.errors import SettingsError, StorageError
from drcli.base.json_record import RecordError
from drcli.bucket.bucket import Bucket, Listing, ObjectDamaged, ObjectMissing
from drcli.model import keys
from drcli.model.checkpoint_choice import missing_parts
from drcli.model.checkpoint_list import HYPERPARAMETERS, METADATA, Item
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_prefix import import_command, kind_of
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_records, reconstruct_scores
from drcli.records.checkpoint import decode_pointer
from drcli.records.scores import Scores
from drcli.transfer.put_model import POINTERS

TRANSIENT = ("model/.ready", "model/.lock", "model/.finished", "ip/ip.json", "ip/done")
"""Signals of a training elsewhere would mislead the next one here."""

SNAPSHOTS = 5


@dataclass(frozen=True)
class Source:
    bucket: Bucket
    prefix: str
    listing: str
    local: bool = False
    file: str = ""

    @property
    def folder(self) -> str:
        return keys.folder(self.prefix)

    @property
    def url(self) -> str:
        return self.file or f"s3://{self.bucket.name}/{self.prefix}"


def list_model(source: Source) -> Listing:
    """All objects of a model.

    Raises:
        SettingsError: It is missing, or lacks one of the racer's files.
    """
    listed = [
        info
        for info in source.bucket.list(source.folder)
        if info.key.removeprefix(source.folder) not in TRANSIENT
    ]
    sizes = {info.key.removeprefix(source.folder): info.size_bytes for info in listed}
    wrong = [
        f"{name} is {'empty' if name in sizes else 'missing'}"
        for name in (keys.REWARD_FUNCTION_FILE, HYPERPARAMETERS, METADATA)
        if not sizes.get(name) and not (name in sizes and _is_in_checkpoints(source, name))
    ]
    if wrong:
        why = ", ".join(wrong) if listed else "There is nothing"
        remedy = f"Correct the address after -s; `{source.listing}` lists all models there."
        if kind_of(sizes) in ("tensorflow", "upload"):
            command = import_command(ModelStore(source.bucket, source.prefix), local=source.local)
            remedy = f"Make it a model here with `{command}`, which can do without these files."
        raise SettingsError(
            f"Meta-data files are not found. Source model {source.url} not valid. Exiting. {why}.",
            remedy=remedy,
        )
    return listed


def _is_in_checkpoints(source: Source, name: str) -> bool:
    records = readable_records(ModelStore(source.bucket, source.prefix))
    file = name.rpartition("/")[2]
    return any(file in record.counters.inputs for record in records)


def list_whole(source: Source) -> Listing:
    """List a model once its pointers name only complete checkpoints.

    Training writes pointers last, so they are read first.

    Raises:
        StorageError: A pointer is damaged, or its checkpoint stays incomplete.
    """
    missing: list[str] = []
    for _ in range(SNAPSHOTS):
        names = named(read_pointers(source), source)
        listed = list_model(source)
        missing = [key for n in sorted(names) for key in missing_parts(listed, source.prefix, n)]
        if not missing:
            return listed
    raise incomplete(source, missing[0])


def check_weights(source: Source) -> None:
    """Raise ObjectDamaged, before the target's model is given up."""
    store = CheckpointStore(ModelStore(source.bucket, source.prefix))
    for name in sorted(named(read_pointers(source), source)):
        # A training that runs there may just have deleted it; the download looks again.
        with suppress(ObjectMissing):
            check_checkpoint(store, name, source)


def check_checkpoint(store: CheckpointStore, name: str, source: Source) -> None:
    """Warn of a damaged record; raise ObjectDamaged for weights."""
    try:
        store.record(name)
    except ObjectDamaged as e:
        errors.warn(f"{e} The copy gets another one, reconstructed from the weights.")
        return
    try:
        store.load(name)
    except ObjectDamaged as e:
        raise ObjectDamaged(
            f"Checkpoint {name} of {source.url} is damaged there. {e}",
            remedy="Restore it there, or fetch another model.",
        ) from e


def read_pointers(source: Source) -> list[Item]:
    """Damaged ones are reconstructed from the checkpoints."""
    found = []
    for name in POINTERS:
        if not source.bucket.exists(source.folder + name):
            continue
        item = Item(name, source.bucket.get(source.folder + name))
        try:
            named([item], source)
        except ObjectDamaged as error:
            scores = reconstruct_scores(ModelStore(source.bucket, source.prefix), "progress")
            if scores is None:
                raise
            errors.warn(f"{error} The copy gets another one, reconstructed from the checkpoints.")
            is_index = name.endswith(".json")
            item = Item(name, scores.encode() if is_index else scores.last_checkpoint.name.encode())
        found.append(item)
    return found


def incomplete(source: Source, missing: str) -> StorageError:
    return StorageError(
        f"The checkpoint at {source.url} is incomplete: {missing} is missing.",
        remedy="If it is being trained, run the command again; otherwise fetch another model.",
    )


def named(pointers: list[Item], source: Source) -> set[str]:
    names = set()
    for item in pointers:
        try:
            if item.name.endswith(".json"):
                scores = Scores.decode(item.data)
                names |= {scores.best_checkpoint.name, scores.last_checkpoint.name}
            else:
                names.add(str(decode_pointer(item.data)))
        except RecordError as e:
            raise ObjectDamaged(
                f"{source.url}/{item.name} is damaged: {e}.",
                remedy="Restore it from a copy, or fetch another model.",
            ) from e
    return names
