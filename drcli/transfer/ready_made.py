"""The ready-made models, and how one gets into a bucket."""

import hashlib
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from drcli.base.errors import DrError, SettingsError, one_of, shown
from drcli.base.json_record import Fingerprint, JsonRecord, RecordError, SafeInt, Seconds
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.loading import load_settings
from drcli.config.new_folder import FolderPlan, FolderReport
from drcli.config.presets import READY_MADE, model_file
from drcli.config.settings import Settings
from drcli.convert.half_weights import restored
from drcli.model import keys
from drcli.model.checkpoint_list import HYPERPARAMETERS, METADATA, Item
from drcli.model.files.params_yaml import training_parameters
from drcli.model.model_store import ModelStore
from drcli.model.write_probe import prove_writing
from drcli.records.checkpoint import CheckpointRecord, Counters, checkpoint_name
from drcli.records.episode_metrics import encode_metrics
from drcli.records.scores import Score
from drcli.transfer.put_model import POINTERS, Delivery, Progress, TransferReport
from drcli.transfer.transfer_buckets import COPY_PATIENCE_S, refuse_nesting, refuse_training

WEIGHTS_FILE, CARD_FILE, TRAINING_FILE = "model.safetensors", "card.json", "training.json"

MODEL_FILES = (keys.REWARD_FUNCTION_FILE, keys.HYPERPARAMETERS_FILE, keys.MODEL_METADATA_FILE)


@dataclass(frozen=True)
class DrivenLaps:
    world: str
    reverse: bool
    disturbed: bool
    status: list[str]
    lap_s: list[Seconds]
    off_track: SafeInt

    @property
    def completed(self) -> int:
        return sum(text == "Lap complete" for text in self.status)


@dataclass(frozen=True)
class Recipe(JsonRecord):
    """How a ready-made model is trained: `training.json`.

    Attributes:
        settings: Other than shipped, by DR_ name.
        hyperparameters: Other than in the model's file, which is for going on.
        starts_from: A ready-made model, or empty.
        checkpoint: "best" or "last".
        drives: Tracks to measure it on.
    """

    summary: str
    seed: SafeInt
    iterations: SafeInt
    settings: dict[str, str]
    worker_settings: list[dict[str, str]] = field(default_factory=list)
    hyperparameters: dict[str, Any] = field(default_factory=dict)
    starts_from: str = ""
    checkpoint: str = "best"
    drives: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Card(JsonRecord):
    """How a ready-made model was made, and drives: `card.json`.

    Attributes:
        sha256: Of all other files.
        processor: Another one rounds differently.
    """

    checkpoint: str
    episodes: SafeInt
    sha256: dict[str, str]
    commit: str
    versions: dict[str, str]
    processor: str
    number_format: str
    processor_minutes: float
    laps: list[DrivenLaps]


@dataclass(frozen=True)
class ReadyMadeModel:
    """A checked model; `tensors` are float32 safetensors."""

    name: str
    recipe: Recipe
    card: Card
    files: dict[str, bytes]
    tensors: bytes

    @property
    def settings(self) -> dict[str, str]:
        """For a training that goes on: the tracks and the disturbances."""
        skipped = ("DR_TRAIN_", "DR_WORKERS")
        return {
            name: text
            for name, text in self.recipe.settings.items()
            if name == "DR_TRAIN_WORLDS" or not name.startswith(skipped)
        }


def read_recipe(name: str) -> Recipe:
    """Raises SettingsError if missing or damaged."""
    if name not in READY_MADE:
        raise SettingsError(
            f"There is no ready-made model called {shown(name)}.", remedy=one_of(READY_MADE, name)
        )
    path = _file(name, TRAINING_FILE)
    try:
        return Recipe.decode(_read(path))
    except RecordError as error:
        raise _damaged(path, str(error)) from error


def read_ready_made(name: str) -> ReadyMadeModel:
    """Checks all files; raises SettingsError if missing or damaged."""
    recipe = read_recipe(name)
    path = _file(name, CARD_FILE)
    try:
        card = Card.decode(_read(path))
        checkpoint_name(card.checkpoint)
    except RecordError as error:
        raise _damaged(path, str(error)) from error
    content = {}
    for file in (*MODEL_FILES, TRAINING_FILE, WEIGHTS_FILE):
        content[file] = _read(_file(name, file))
        if hashlib.sha256(content[file]).hexdigest() != card.sha256.get(file):
            raise _damaged(_file(name, file), f"it is not the one that {CARD_FILE} describes")

    tensors = restored(content[WEIGHTS_FILE], str(_file(name, WEIGHTS_FILE)))
    return ReadyMadeModel(name, recipe, card, {f: content[f] for f in MODEL_FILES}, tensors)


def place_of(settings: Settings, name: str) -> Bucket:
    """A writable bucket without such a model; raises DrError."""
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    model = ModelStore(bucket, name)
    refuse_nesting(model, settings.custom_files_prefix, flag="--prefix")
    refuse_training(model)
    there = {info.key.removeprefix(keys.folder(name)) for info in bucket.list(keys.folder(name))}
    if there & set(POINTERS):
        raise SettingsError(
            f"s3://{bucket.name}/{name} already contains a model.",
            remedy="Choose another name with --prefix.",
        )
    prove_writing(model, deletes=True)
    return bucket


def put_ready_made(
    model: ReadyMadeModel, settings: Settings, prefix: str, progress: Progress
) -> TransferReport:
    """Write it, the pointers last; on DrError, repeat it."""
    bucket = open_bucket(settings.storage, patience_s=COPY_PATIENCE_S)
    items = _items(model, settings)
    with progress("Writing model", sum(len(item.data) for item in items)) as watch:
        delivery = Delivery(ModelStore(bucket, prefix), watch)
        delivery.withdraw()
        for folder in (keys.rollouts_folder(prefix), keys.run_folder(prefix)):
            bucket.delete([info.key for info in bucket.list(folder)])
        delivery.send(items)
        delivery.delete_strays("model/")
        delivery.publish(_score(model))
        delivery.confirm([item.name for item in items])
    target = f"s3://{bucket.name}/{prefix}"
    return delivery.complete(TransferReport(model.name, target, model.card.checkpoint))


def _score(model: ReadyMadeModel) -> Score:
    first = model.card.laps[0] if model.card.laps else None
    if first is None or not first.status:
        return Score(model.card.checkpoint)
    return Score(model.card.checkpoint, 100.0 * first.completed / len(first.status))


def _items(model: ReadyMadeModel, settings: Settings) -> list[Item]:
    files, name = model.files, model.card.checkpoint
    inputs = {
        file: files[file].decode() for file in (keys.MODEL_METADATA_FILE, keys.HYPERPARAMETERS_FILE)
    }
    counters = Counters(
        episodes=model.card.episodes,
        seed=model.recipe.seed,
        inputs=inputs,
    )
    record = CheckpointRecord(name, Fingerprint.of(model.tensors), counters=counters)
    return [
        Item(f"model/{name}.safetensors", model.tensors),
        Item(f"model/{name}.json", record.encode()),
        Item(METADATA, files[keys.MODEL_METADATA_FILE]),
        Item(HYPERPARAMETERS, files[keys.HYPERPARAMETERS_FILE]),
        Item(keys.REWARD_FUNCTION_FILE, files[keys.REWARD_FUNCTION_FILE]),
        Item(settings.model.parameters_file, training_parameters(settings)),
        Item(
            keys.training_metrics("metrics"), encode_metrics([], settings.train_best_model_metric)
        ),
    ]


def _file(name: str, file: str) -> Path:
    return model_file(f"models/{name}/{file}")


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise _damaged(path, error.strerror or str(error)) from error


def _damaged(path: Path, why: str) -> SettingsError:
    return SettingsError(
        f"{path}: this file of a ready-made model cannot be used: {why}.",
        remedy="Install drcli again, or get that file again with `git checkout`.",
    )


# A new working folder or experiment that begins with a ready-made model.


def values_with(
    model: ReadyMadeModel, given: Mapping[str, str], *, experiment: str | None = None
) -> dict[str, str]:
    named = {} if experiment is not None else {"DR_LOCAL_S3_MODEL_PREFIX": model.name}
    return {**named, **model.settings, **given}


def check_place(
    plan: FolderPlan, experiment: str | None, looking: AbstractContextManager[object]
) -> None:
    """Refuse a bucket that cannot take the model, before anything is written.

    A local bucket that does not exist yet can: asking would create it.

    Raises:
        DrError: It cannot be reached or written, or has such a model.
    """
    here = f"experiments/{experiment}/" if experiment else ""
    contents = {
        file.name.removeprefix(here): file.data
        for file in plan.files
        if file.name in (f"{here}run.env", "system.env")
    }
    flags = {"DR_EXPERIMENT_NAME": ""}  # the file of the experiment stands for run.env
    settings = load_settings(plan.folder, environ={}, flags=flags, contents=contents)
    if settings.cloud != "local" or settings.storage.data_dir.exists():
        with looking:
            place_of(settings, settings.model_prefix)


def put_into_bucket(
    report: FolderReport,
    plan: FolderPlan,
    experiment: str | None,
    model: ReadyMadeModel,
    progress: Progress,
) -> FolderReport:
    """Put the model into the bucket of a written folder.

    Raises:
        DrError: It failed; the command can be repeated.
    """
    try:
        flags = {"DR_EXPERIMENT_NAME": experiment or ""}
        settings = load_settings(plan.folder, environ={}, flags=flags)
        put = put_ready_made(model, settings, settings.model_prefix, progress)
    except DrError as error:
        error.args = (f"The files are written, but the model is not in the bucket: {error}",)
        raise
    return replace(report, model=put.target, checkpoint=put.checkpoint)
