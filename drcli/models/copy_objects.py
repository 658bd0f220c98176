"""Copies the objects of a model to another bucket, even while a training changes them."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from drcli.base import notices
from drcli.base.errors import SettingsError, StorageError
from drcli.base.json_record import RecordError
from drcli.exchange.checkpoint import CheckpointName
from drcli.exchange.scores import Scores
from drcli.modelfiles.params_yaml import moved_training_parameters
from drcli.models.checkpoint_choice import Item, missing_parts
from drcli.models.checkpoint_files import HYPERPARAMETERS, METADATA, PARAMETERS_FILE
from drcli.models.delivery import POINTERS, Delivery
from drcli.store import keys
from drcli.store.bucket import (
    Bucket,
    Listing,
    ObjectDamaged,
    ObjectInfo,
    ObjectMissing,
    Watch,
)
from drcli.store.checkpoints import CheckpointStore
from drcli.store.reconstruct import readable_records, reconstruct_scores

TRANSIENT = (
    "model/.ready",
    "model/.lock",
    "model/.finished",
    "ip/ip.json",
    "ip/done",
)
"""Signals of a training that runs elsewhere; a copy of them would mislead the next one here."""

_SNAPSHOTS = 5
"""How often a model is listed again because a running training has changed it."""


@dataclass(frozen=True)
class Source:
    """A model to be fetched.

    Attributes:
        listing: The command that lists the models of that bucket.
    """

    bucket: Bucket
    prefix: str
    listing: str

    @property
    def url(self) -> str:
        """Bucket and prefix."""
        return f"s3://{self.bucket.name}/{self.prefix}"


def list_model(source: Source) -> Listing:
    """Everything that belongs to a model.

    Raises:
        SettingsError: There is none.
    """
    folder = keys.folder(source.prefix)
    listed = [
        info
        for info in source.bucket.list(folder)
        if info.key.removeprefix(folder) not in TRANSIENT and not info.key.endswith("/")
    ]
    sizes = {info.key.removeprefix(folder): info.size_bytes for info in listed}
    wrong = [
        f"{name} is {'empty' if name in sizes else 'missing'}"
        for name in (keys.REWARD_FUNCTION_FILE, HYPERPARAMETERS, METADATA)
        if not sizes.get(name) and not (name in sizes and _is_saved(source, name))
    ]
    if wrong:
        why = ", ".join(wrong) if listed else "There is nothing"
        raise SettingsError(
            f"Meta-data files are not found. Source model {source.url} not valid. Exiting. {why}.",
            remedy=f"Correct the address after -s; `{source.listing}` shows all models there.",
        )
    return listed


def _is_saved(source: Source, name: str) -> bool:
    """Whether a file that is empty comes back from a checkpoint."""
    records = readable_records(source.bucket, source.prefix)
    file = name.rpartition("/")[2]
    return any(file in record.counters.inputs for record in records)


def list_whole(source: Source) -> Listing:
    """The same, once the pointers of the model name only checkpoints that are there.

    A training that runs there may prune a checkpoint between two looks; the pointers are read
    first, because it writes them last.

    Raises:
        SettingsError: There is no model.
        StorageError: The pointers cannot be read, or name something that is not there.
    """
    missing: list[str] = []
    for _ in range(_SNAPSHOTS):
        names = _named(_pointers(source), source.url)
        listed = list_model(source)
        missing = [key for n in sorted(names) for key in missing_parts(listed, source.prefix, n)]
        if not missing:
            return listed
    raise _incomplete(source, missing[0])


def check_weights(source: Source) -> None:
    """Read the checkpoints that the pointers name, before something else is given up for them.

    Raises:
        ObjectDamaged: One is not what was written.
    """
    store = CheckpointStore(source.bucket, source.prefix)
    for name in sorted(_named(_pointers(source), source.url)):
        # A training that runs there may just have deleted it; fetching looks again.
        with suppress(ObjectMissing):
            _load(store, name, source.url)


class Fetcher:
    """Brings the objects of one model to another bucket."""

    def __init__(self, source: Source, here: Bucket, target: str, watch: Watch) -> None:
        self._source = source
        self._there = source.bucket
        self._folder = keys.folder(source.prefix)
        self._here = here
        self._target = target
        self._watch = watch

    def fetch(self, delivery: Delivery, listed: Listing) -> list[Item]:
        """Bring everything but the pointers.

        A training that runs at the source deletes old checkpoints and writes new ones: what is
        gone is left out, and what came meanwhile is fetched too, until the pointers name only what
        was fetched.

        Returns:
            The pointers.

        Raises:
            StorageError: They name something that is not there.
        """
        missing: list[str] = []
        for _ in range(_SNAPSHOTS):
            delivery.send(self._items(delivery, listed))
            pointers = _pointers(self._source)
            missing = self._missing(pointers)
            if not missing:
                return pointers
            done = {*delivery.copied, *delivery.unchanged}
            listed = [o for o in list_model(self._source) if self._name(o) not in done]
        raise _incomplete(self._source, missing[0])

    def _name(self, info: ObjectInfo) -> str:
        return info.key.removeprefix(self._folder)

    def _items(self, delivery: Delivery, listed: Listing) -> Iterator[Item]:
        for info in listed:
            name = self._name(info)
            if name in POINTERS:
                continue
            if delivery.has(name, info):
                self._watch(info.size_bytes)
                continue
            try:
                data = self._there.get(info.key, watch=self._watch)
            except ObjectMissing:
                continue
            yield Item(name, self._moved(data) if name == PARAMETERS_FILE else data)

    def _moved(self, data: bytes) -> bytes:
        """The parameter file for its new place."""
        try:
            return moved_training_parameters(data, self._here.name, self._target)
        except ValueError:
            return data  # nothing of ours reads it: the copy is as strange as the original

    def _missing(self, pointers: list[Item]) -> list[str]:
        """Keys that were not fetched although the pointers name their checkpoint.

        Raises:
            ObjectDamaged: A checkpoint that was fetched is not what was written.
        """
        listed = self._here.list(keys.model_folder(self._target))
        missing: list[str] = []
        for name in sorted(_named(pointers, self._source.url)):
            missing += missing_parts(listed, self._target, name)
            record = keys.checkpoint_record(self._target, name)
            if not missing and any(info.key == record for info in listed):
                _load(CheckpointStore(self._here, self._target), name, self._source.url)
        return missing


def _load(store: CheckpointStore, name: str, source: str) -> None:
    try:
        store.record(name)
    except ObjectDamaged as e:
        notices.warn(f"{e} The copy gets another one, worked out from the weights.")
        return
    try:
        store.load(name)
    except ObjectDamaged as e:
        raise ObjectDamaged(
            f"Checkpoint {name} of {source} is damaged there. {e}",
            remedy="Restore it there, or fetch another model.",
        ) from e


def _pointers(source: Source) -> list[Item]:
    """Those of the two pointers that are there; what is damaged is worked out again."""
    folder = keys.folder(source.prefix)
    found = [
        Item(name, source.bucket.get(folder + name))
        for name in POINTERS
        if source.bucket.exists(folder + name)
    ]
    return [_readable(source, item) for item in found]


def _readable(source: Source, item: Item) -> Item:
    try:
        _named([item], source.url)
    except ObjectDamaged as error:
        scores = reconstruct_scores(source.bucket, source.prefix, "progress")
        if scores is None:
            raise
        notices.warn(f"{error} The copy gets another one, worked out from the checkpoints.")
        if item.name.endswith(".json"):
            return Item(item.name, scores.encode())
        return Item(item.name, scores.last_checkpoint.name.encode())
    return item


def _incomplete(source: Source, missing: str) -> StorageError:
    return StorageError(
        f"{source.url} names a checkpoint that cannot be fetched whole: {missing} is missing.",
        remedy="If it is being trained, run the command again; otherwise fetch another model.",
    )


def _named(pointers: list[Item], source: str) -> set[str]:
    """Checkpoints that the pointers name."""
    names = set()
    for item in pointers:
        try:
            if item.name.endswith(".json"):
                scores = Scores.decode(item.data)
                names |= {scores.best_checkpoint.name, scores.last_checkpoint.name}
            else:
                name = item.data.decode(errors="replace").strip()
                if CheckpointName.parse(name) is None:
                    raise RecordError("it does not name a checkpoint")
                names.add(name)
        except RecordError as e:
            raise ObjectDamaged(
                f"{source}/{item.name} is damaged: {e}.",
                remedy="Restore it from a copy, or fetch another model.",
            ) from e
    return names
