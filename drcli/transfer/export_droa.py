"""Exports a model for DeepRacer on AWS: a folder and an archive."""

import gzip
import io
import json
import tarfile
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from drcli.base import errors
from drcli.base.errors import SettingsError
from drcli.base.installation import lazy_imports
from drcli.bucket.bucket import ObjectDamaged, ObjectNewer
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.checkpoint_list import HYPERPARAMETERS, PARAMETERS_FILE, Item
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.params_yaml import (
    DROA_TRACKS,
    Direction,
    droa_parameters,
    moved_training_parameters,
    read_parameters,
    split_world,
    training_parameters,
)
from drcli.model.growing_file import read_all_metrics
from drcli.model.model_store import ModelStore
from drcli.records.episode_metrics import EpisodeMetrics, encode_metrics
from drcli.transfer.export_forms import (
    CheckpointExport,
    ExportReport,
    checkpoint_export,
    report_of,
    reward_function,
)
from drcli.transfer.export_model import (
    ExportTarget,
    Prepare,
    Selection,
    pointer_items,
    read_export_source,
    unchanged,
    write_archive,
    write_items,
)
from drcli.transfer.put_model import Progress

with lazy_imports():
    from drcli.tracks import tracks_folder

_KEYS = (
    "batch_size",
    "beta_entropy",
    "discount_factor",
    "e_greedy_value",
    "epsilon_steps",
    "exploration_type",
    "loss_type",
    "lr",
    "num_episodes_between_training",
    "num_epochs",
    "stack_size",
    "term_cond_avg_score",
    "term_cond_max_episodes",
)
_LOSSES = {"mean squared error": "mean_squared_error"}
"""Everything but `huber` counts as this."""

_LEVEL = 1
"""More hardly makes weights smaller."""

_NOT_VERIFIED = (
    "DeepRacer on AWS has not imported this model. Its rules were read in its source of November "
    "2026; before it accepts a model, it loads the checkpoint into its simulator.",
)


def read_droa_export(
    settings: Settings, selection: Selection, world: str | None, prepare: Prepare = unchanged
) -> CheckpointExport:
    """All files in memory; `world` may end in `_cw` or `_ccw`. Raises DrError."""
    source = read_export_source(settings, selection)
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    model = ModelStore(bucket, source.prefix)
    if reward_function(settings, source.prefix) is None:
        raise SettingsError(
            f"{source.url} has no {keys.REWARD_FUNCTION_FILE}, which DeepRacer on AWS asks for.",
            remedy="Copy the reward function that the model was trained with to that place.",
        )
    parameters, of_track = _parameters(settings, model, world)
    exported = checkpoint_export(settings, prepare(source))
    items = {item.name: item for item in exported.items}
    notes = [*exported.notes, *of_track]
    design = exported.source.design
    metadata = design.files[keys.MODEL_METADATA_FILE]
    found = [
        Item(keys.MODEL_METADATA_FILE, metadata),
        Item(PARAMETERS_FILE, parameters),
        Item(HYPERPARAMETERS, droa_hyperparameters(design.parameters)),
    ]
    records, metric = _metrics(settings, model)
    if records:
        found.append(_training_metrics(records, metric, exported))
    else:
        notes.append("The model has no training metrics, so it will have no reward graph there.")
    items |= {item.name: item for item in found}
    return replace(exported, items=list(items.values()), notes=notes)


def export_droa(
    exported: CheckpointExport,
    target: ExportTarget | None,
    archive: Path | None,
    progress: Progress,
) -> ExportReport:
    """Write folder (or objects) and archive; raises DrError."""
    if target is not None:
        write_items(target, exported.items, exported.score, progress)
    if archive is not None:
        write_archive(archive, _archive(exported))
    place = str(archive) if target is None else target.shown
    report = report_of(exported, place)
    return replace(
        report,
        archive=None if archive is None else str(archive),
        not_verified=[*report.not_verified, *_NOT_VERIFIED],
    )


def package_files(exported: CheckpointExport) -> dict[str, bytes]:
    items = [*exported.items, *pointer_items(exported.score)]
    return {item.name: item.data for item in items}


def _parameters(
    settings: Settings, model: ModelStore, world: str | None
) -> tuple[bytes, list[str]]:
    key = keys.parameter_file(model.prefix, settings.model.parameters_file)
    written = model.bucket.get(key) if model.bucket.exists(key) else training_parameters(settings)
    try:
        values = moved_training_parameters(written, model.bucket.name, model.prefix, world)
    except ValueError as e:
        errors.warn(f"{model.bucket.name}/{key} is damaged: {e}. The settings are used instead.")
        values = moved_training_parameters(
            training_parameters(settings), model.bucket.name, model.prefix, world
        )
    name = str(read_parameters(values).get("WORLD_NAME", ""))
    track, _ = split_world(name)
    try:
        data = droa_parameters(values, _route(settings, name))
    except ValueError as e:
        raise SettingsError(
            f"{model.bucket.name}/{key} cannot be used by DeepRacer on AWS: {e}.",
            remedy="Name the track with its direction, as in --world reinvent_base_ccw.",
        ) from e
    if track in DROA_TRACKS:
        return data, []
    return data, [
        f"{track} is not a track of DeepRacer on AWS, which will refuse the import; name another "
        "one with --world."
    ]


def _route(settings: Settings, world: str) -> Direction | None:
    try:
        direction = tracks_folder.show_track(world, settings.tracks_folder).facts.direction
    except SettingsError:
        return None
    if direction == "clockwise":
        return "CLOCKWISE"
    return "COUNTER_CLOCKWISE" if direction == "counterclockwise" else None


def droa_hyperparameters(parameters: Hyperparameters) -> bytes:
    """Those that DeepRacer on AWS knows, in its words."""
    values = {key: getattr(parameters, key) for key in _KEYS}
    values["loss_type"] = _LOSSES.get(values["loss_type"], values["loss_type"])
    return json.dumps(values, indent=2).encode()


def _metrics(settings: Settings, model: ModelStore) -> tuple[list[EpisodeMetrics], str]:
    folders = [keys.metrics_prefix(model.prefix)]
    if model.prefix == settings.model.prefix:
        folders.append(settings.model.metrics_prefix)
    records: list[EpisodeMetrics] = []
    for folder in dict.fromkeys(folders):
        for info in model.bucket.list(keys.folder(folder)):
            name = info.key.removeprefix(keys.folder(folder))
            if not (name.startswith("TrainingMetrics") and name.endswith(".json")):
                continue
            try:
                records += read_all_metrics(model.bucket, info.key)
            except (ObjectDamaged, ObjectNewer) as error:
                errors.warn(f"{error} It is left out.")
        if records:
            break
    records.sort(key=lambda record: (record.iteration or 0, record.metric_time))
    return records, settings.model.metric


def _training_metrics(
    records: Sequence[EpisodeMetrics], metric: str, exported: CheckpointExport
) -> Item:
    """No other metrics are read there, and no keys of ours."""
    plain = [replace(record, iteration=None) for record in records]
    stamp = datetime.now(UTC).strftime("%Y%m%d%H%M%S")
    name = f"training-{stamp}-{exported.source.chosen.number}.json"
    return Item(f"metrics/training/{name}", encode_metrics(plain, metric))


def _archive(exported: CheckpointExport) -> bytes:
    packed = io.BytesIO()
    with (
        gzip.GzipFile(fileobj=packed, mode="wb", compresslevel=_LEVEL, mtime=0) as zipped,
        tarfile.open(fileobj=zipped, mode="w") as archive,
    ):
        for name, data in package_files(exported).items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            member.mode = 0o644
            archive.addfile(member, io.BytesIO(data))
    return packed.getvalue()
