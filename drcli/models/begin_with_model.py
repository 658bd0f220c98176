"""A new working folder, or an experiment, that begins with a ready-made model in its bucket."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace

from drcli.base.errors import DrError
from drcli.config.loading import load_settings
from drcli.config.write_folder import FolderPlan, FolderReport
from drcli.models.put_model import Progress
from drcli.models.ready_made import ReadyMadeModel, place_of, put_ready_made


def values_with(
    model: ReadyMadeModel, given: Mapping[str, str], *, experiment: str | None = None
) -> dict[str, str]:
    """The settings that were given, and for the rest those of the model's training.

    An experiment names its model after itself.
    """
    named = {} if experiment is not None else {"DR_LOCAL_S3_MODEL_PREFIX": model.name}
    return {**named, **model.settings, **given}


def check_place(
    plan: FolderPlan, experiment: str | None, looking: AbstractContextManager[object]
) -> None:
    """Refuse a bucket that cannot take the model, before anything is written.

    A bucket on this machine that does not exist yet can: to ask would create it.

    Args:
        plan: What is about to be written.
        experiment: Its name, if the plan is one of an experiment.
        looking: Entered while the bucket is asked.

    Raises:
        DrError: It cannot be reached or written, or has a model of that name.
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
    """Put the model into the bucket of the folder, which has been written.

    Raises:
        DrError: It is not there; the folder is, and the command can be repeated.
    """
    try:
        flags = {"DR_EXPERIMENT_NAME": experiment or ""}
        settings = load_settings(plan.folder, environ={}, flags=flags)
        put = put_ready_made(model, settings, settings.model_prefix, progress)
    except DrError as error:
        error.args = (f"The files are written, but the model is not in the bucket: {error}",)
        raise
    return replace(report, model=put.target, checkpoint=put.checkpoint)
