"""Trainings that `dr-bench` measures."""

import json
from dataclasses import replace
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.problems import ProblemsError
from drcli.benchmark.work_order import WorkOrder
from drcli.config.example_files import model_file, settings_file
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.modelfiles.custom_files import local_file
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata
from drcli.store import keys

_FILES = (keys.HYPERPARAMETERS_FILE, keys.MODEL_METADATA_FILE)


def standard_order(settings: Settings, folder: Path) -> WorkOrder:
    """Shipped files, with the processor settings of the folder; the caller sets the times."""
    flags = {"DR_EXPERIMENT_NAME": ""}
    shipped = load_settings(folder, environ={}, flags=flags, contents=shipped_settings()).run
    own = settings.run.train
    train = shipped.train.replaced(
        priority=own.priority,
        threads=own.threads,
        torch_precision=own.torch_precision,
        sagemaker_cuda_devices=own.sagemaker_cuda_devices,
        worker_device=own.worker_device,
    )
    files = {name: model_file(name).read_text("utf-8") for name in _FILES}
    return WorkOrder(
        race=shipped.race(),
        train=train,
        hyperparameters=files[keys.HYPERPARAMETERS_FILE],
        metadata=files[keys.MODEL_METADATA_FILE],
        reward_file=str(model_file(keys.REWARD_FUNCTION_FILE)),
        seconds=0.0,
        most_seconds=0.0,
    )


def shipped_settings() -> dict[str, bytes]:
    return {name: settings_file(name).read_bytes() for name in ("run.env", "system.env")}


def own_order(settings: Settings, standard: WorkOrder) -> tuple[WorkOrder | None, str]:
    """If it differs from the standard one; else why it is left out."""
    folder = settings.custom_files_dir
    texts = dict(zip(_FILES, (standard.hyperparameters, standard.metadata), strict=True))
    reward = Path(standard.reward_file)
    if settings.untrainable is not None:
        return None, str(settings.untrainable)
    try:
        for name in texts:
            found = local_file(folder, name)
            if found is not None:
                texts[name] = found.data.decode("utf-8-sig")
        Hyperparameters.from_bytes(texts[keys.HYPERPARAMETERS_FILE].encode())
        ModelMetadata.from_bytes(texts[keys.MODEL_METADATA_FILE].encode())
    except (ProblemsError, SettingsError, UnicodeDecodeError) as error:
        return None, str(error).splitlines()[0]
    if (folder / keys.REWARD_FUNCTION_FILE).is_file():
        reward = folder / keys.REWARD_FUNCTION_FILE
    order = replace(
        standard,
        race=settings.race,
        train=settings.run.train,
        hyperparameters=texts[keys.HYPERPARAMETERS_FILE],
        metadata=texts[keys.MODEL_METADATA_FILE],
        reward_file=str(reward),
    )
    same_reward = reward.read_bytes() == Path(standard.reward_file).read_bytes()
    return (None if same_reward and _same_work(order, standard) else order), ""


def _same_work(one: WorkOrder, other: WorkOrder) -> bool:
    def facts(order: WorkOrder) -> tuple[object, ...]:
        race = {k: v for k, v in order.race.to_json().items() if k not in ("directory", "sources")}
        return race, json.loads(order.hyperparameters), json.loads(order.metadata)

    return facts(one) == facts(other)
