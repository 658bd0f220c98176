"""Copies the files of a training below its model prefix, where they stay as they are."""

from pathlib import PurePosixPath

from drcli.config.settings import Settings
from drcli.exchange.frozen_curriculum import FrozenCurriculum
from drcli.modelfiles.custom_files import Inputs, upload_custom_files
from drcli.modelfiles.network_shape import Design
from drcli.modelfiles.params_yaml import training_parameters
from drcli.store import keys
from drcli.store.bucket import Bucket


def freeze(
    settings: Settings,
    bucket: Bucket,
    inputs: Inputs,
    design: Design,
    curriculum: FrozenCurriculum | None = None,
) -> None:
    """Copy the files of the training below the model prefix, with its curriculum if it has one.

    `design` is that of the newest checkpoint: the files of a training that goes on become the
    model's with the first checkpoint that has learned with them.
    """
    prefix = settings.model_prefix
    if curriculum is not None:
        bucket.put(keys.curriculum(prefix), curriculum.encode())
    upload_custom_files(settings.custom_files, bucket, inputs)
    bucket.put(keys.reward_function(prefix), inputs.reward.data)
    design.write(bucket, prefix)
    for name, own in parameter_files(settings).items():
        bucket.put(keys.parameter_file(prefix, name), training_parameters(own))


def parameter_files(settings: Settings) -> dict[str, Settings]:
    """The settings of each parameter file: each worker with its own race has its own file."""
    file = PurePosixPath(settings.training_params_file)
    files = {settings.training_params_file: settings}
    if settings.overrides:
        for worker in range(settings.workers):
            name = file.with_stem(f"{file.stem}_{worker + 1}")
            files[str(name)] = settings.for_worker(worker)
    return files
