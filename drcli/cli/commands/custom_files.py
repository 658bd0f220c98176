"""`dr upload-custom-files` and `dr download-custom-files`."""

from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.show import show
from drcli.cli.working_folder import settings

with lazy_imports():
    from drcli.transfer import copy_custom_files


def upload_custom_files() -> None:
    """Copy custom_files/, or that of the experiment, to DR_LOCAL_S3_CUSTOM_FILES_PREFIX.

    Copies every file in the folder. Nothing is deleted in the bucket.

    Example: dr-upload-custom-files
    """
    loaded = settings()
    report = copy_custom_files.upload_custom_files(
        loaded.custom_files, loaded.storage, terminal.say
    )
    for name in report.refused:
        terminal.warn(f"{report.folder}/{name} was skipped: its name is not UTF-8.")
    show(report, up=True)


def download_custom_files() -> None:
    """Copy DR_LOCAL_S3_CUSTOM_FILES_PREFIX to custom_files/, or to that of the experiment.

    Nothing is deleted: a file that differs is kept as NAME.bak.

    Example: dr-download-custom-files
    """
    loaded = settings()
    report = copy_custom_files.download_custom_files(
        loaded.custom_files, loaded.storage, terminal.say
    )
    for name in report.refused:
        terminal.warn(f"{report.place}/{name} was skipped: it leads out of {report.folder}.")
    if not report.copied and not report.unchanged:
        terminal.warn(f"There is nothing at {report.place}.")
    show(report, up=False)
