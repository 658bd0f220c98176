"""`dr set-upload-model`."""

from dataclasses import dataclass
from typing import Annotated

import typer

from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings, working_folder
from drcli.config.editing import set_values


@dataclass(frozen=True)
class UploadName:
    """Where uploads go from now on.

    Attributes:
        file: The file that was edited.
        before: The prefix until now.
        after: The prefix from now on.
        target: The whole address.
    """

    file: str
    before: str
    after: str
    target: str


def set_upload_model(
    prefix: Annotated[str, typer.Argument(metavar="PREFIX", help="Name of the next upload.")],
    as_json: AsJson = False,
) -> None:
    """Choose the name of the next upload: writes DR_UPLOAD_S3_PREFIX to run.env.

    Example: dr-set-upload-model team/fast-car-1
    """
    folder, before = working_folder(), settings().upload_s3_prefix
    edit = set_values(folder, {"DR_UPLOAD_S3_PREFIX": prefix}, file="run.env")
    for warning in edit.warnings:
        console.warn(warning)
    after = settings()
    place = f"s3://{after.upload_s3_bucket}/{after.upload_s3_prefix}"
    file = str(folder / edit.changes[0].file)
    report = UploadName(file, before, after.upload_s3_prefix, place)
    console.emit(report, f"The next upload goes to {place} (written to {file}).", as_json=as_json)
