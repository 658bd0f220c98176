"""Copies the files of a training below its model prefix."""

from collections.abc import Mapping
from pathlib import PurePosixPath

from drcli.config.settings import Settings
from drcli.exchange.frozen_curriculum import FrozenCurriculum
from drcli.modelfiles.custom_files import (
    Inputs,
    texts_of,
    upload_custom_files,
    write_model_files,
)
from drcli.modelfiles.network_shape import Design
from drcli.modelfiles.params_yaml import training_parameters
from drcli.store import keys
from drcli.store.bucket import Bucket


def files_to_train_with(settings: Settings, inputs: Inputs, design: Design) -> dict[str, str]:
    """With all values of hyperparameters."""
    parameters = design.parameters.canonical_json(design.metadata.training_algorithm)
    own = parameter_files(settings).items()
    return {
        **texts_of(inputs),
        keys.HYPERPARAMETERS_FILE: parameters,
        **{name: training_parameters(each).decode() for name, each in own},
    }


def freeze(
    settings: Settings,
    bucket: Bucket,
    inputs: Inputs,
    files: Mapping[str, str],
    curriculum: FrozenCurriculum | None = None,
    resumed: Design | None = None,
) -> None:
    """Copy the files of a start and its curriculum below the model prefix.

    Those of a `resumed` training become the model's with the first checkpoint that has learned
    with them.
    """
    prefix = settings.model_prefix
    if curriculum is not None:
        bucket.put(keys.curriculum(prefix), curriculum.encode())
    upload_custom_files(settings.custom_files, bucket, inputs)
    if resumed is not None:
        write_model_files(bucket, prefix, resumed.texts)
    write_model_files(bucket, prefix, files, only_missing=resumed is not None)


def parameter_files(settings: Settings) -> dict[str, Settings]:
    file = PurePosixPath(settings.training_params_file)
    files = {settings.training_params_file: settings}
    if settings.overrides:
        for worker in range(settings.workers):
            name = file.with_stem(f"{file.stem}_{worker + 1}")
            files[str(name)] = settings.for_worker(worker)
    return files
