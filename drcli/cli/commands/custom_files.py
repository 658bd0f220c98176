"""`dr upload-custom-files` and `dr download-custom-files`."""

from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings


def upload_custom_files(as_json: AsJson = False) -> None:
    """Copy custom_files/, or that of the experiment, to DR_LOCAL_S3_CUSTOM_FILES_PREFIX.

    All files in it, settings files included; nothing is deleted there.

    Example: dr-upload-custom-files
    """
    from drcli.cli import console
    from drcli.cli.views import models_view
    from drcli.models import copy_custom_files

    loaded = settings()
    report = copy_custom_files.upload_custom_files(loaded.custom_files, loaded.storage, console.say)
    for name in report.refused:
        console.warn(f"{report.folder}/{name} is left out: its name is no UTF-8.")
    console.emit(report, models_view.custom_files(report, up=True), as_json=as_json)


def download_custom_files(as_json: AsJson = False) -> None:
    """Copy DR_LOCAL_S3_CUSTOM_FILES_PREFIX into custom_files/, or into that of the experiment.

    Nothing is deleted; a file that was different stays beside the new one as NAME.bak.

    Example: dr-download-custom-files
    """
    from drcli.cli import console
    from drcli.cli.views import models_view
    from drcli.models import copy_custom_files

    loaded = settings()
    report = copy_custom_files.download_custom_files(
        loaded.custom_files, loaded.storage, console.say
    )
    for name in report.refused:
        console.warn(f"{report.place}/{name} would lie outside {report.folder} and is left out.")
    if not report.copied and not report.unchanged:
        console.warn(f"There is nothing at {report.place}.")
    console.emit(report, models_view.custom_files(report, up=False), as_json=as_json)
