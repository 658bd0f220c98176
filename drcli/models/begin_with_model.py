"""A new working folder or experiment that begins with a ready-made model."""

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
