"""How copied models and files look, and a list of models."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.filesize import decimal
from rich.text import Text

from drcli.cli.views.layout import Fitted, Rows

if TYPE_CHECKING:
    from drcli.models.copy_custom_files import CustomFilesReport
    from drcli.models.download import DownloadReport
    from drcli.models.model_list import CheckpointEntry, ModelList
    from drcli.models.upload import UploadReport
    from drcli.models.upload_prefix import UploadIncrement

_WITH_TIME = 100
"""Columns from which a date has its time."""

_DAY, _MINUTE = 10, 16
"""Characters of a time in ISO 8601 up to its day and its minute."""


def upload(report: "UploadReport") -> RenderableType:
    """The result of an upload."""
    would = "Would upload" if report.dry_run else "Uploaded"
    lines = [
        f"{would} {report.checkpoint} of {report.source} to {report.target}: "
        f"{_counted(report.copied, report.copied_bytes, report.unchanged)}."
    ]
    if report.deleted:
        verb = "would be deleted" if report.dry_run else "deleted"
        lines.append(f"{files(len(report.deleted))} of earlier uploads {verb}.")
    if report.older:
        lines.append(
            f"Older checkpoints are kept: {len(report.older)}, {decimal(report.older_bytes)}; "
            "-w deletes them."
        )
    return Text("\n".join(lines))


def download(report: "DownloadReport") -> RenderableType:
    """The result of a download."""
    would = "Would download" if report.dry_run else "Downloaded"
    lines = [
        f"{would} {report.source} to {report.target}: "
        f"{_counted(report.copied, report.copied_bytes, report.unchanged)}."
    ]
    if not report.checkpoint:
        lines.append("It has no checkpoint yet, so it cannot drive.")
    if report.deleted:
        verb = "would be deleted" if report.dry_run else "deleted"
        lines.append(f"Not part of it and {verb}: {files(len(report.deleted))}.")
    if report.strays:
        lines.append(f"Not part of it: {files(len(report.strays))} at the target; -w deletes them.")
    lines += [f"Wrote {path}" for path in report.custom_files]
    return Text("\n".join(lines))


def upload_increment(step: "UploadIncrement") -> RenderableType:
    """The name of the next upload."""
    wiped = f" {files(step.wiped)} deleted there." if step.wiped else ""
    return Text(f"The next upload goes to {step.after}.{wiped}")


def custom_files(report: "CustomFilesReport", *, up: bool) -> RenderableType:
    """Which of the racer's files were copied, and where to."""
    place = report.place if up else report.folder
    lines = [*report.copied, f"{files(len(report.copied))} copied to {place}"]
    lines[-1] += f", {len(report.unchanged)} unchanged." if report.unchanged else "."
    return Text("\n".join(lines))


def files(count: int) -> str:
    """So many files."""
    return "1 file" if count == 1 else f"{count:,} files"


def models(found: "ModelList") -> RenderableType:
    """The models of a bucket."""
    if not found.models:
        matching = f" that matches {found.pattern}" if found.pattern else ""
        return Text(f"There is no model in s3://{found.bucket}{matching}.")
    return Group(
        Text(f"s3://{found.bucket}", style="bold"),
        Fitted(lambda columns: _table(found, columns)),
    )


def _table(found: "ModelList", columns: int) -> Rows:
    digits = _MINUTE if columns >= _WITH_TIME else _DAY
    return Rows(
        ("model", "ckpts", "best", "last", "size", "modified"),
        [
            (
                Text.assemble(model.prefix, (" (training)" if model.training else "", "green")),
                str(model.checkpoints),
                _checkpoint(model.best),
                _checkpoint(model.last),
                decimal(model.size_bytes),
                model.modified[:digits].replace("T", " "),
            )
            for model in found.models
        ],
        left=("model", "modified"),
    )


def _checkpoint(entry: "CheckpointEntry | None") -> str:
    if entry is None:
        return "-"
    number = entry.name.partition("_")[0]
    return number if entry.metric is None else f"{number} ({entry.metric:.4g})"


def _counted(copied: list[str], size_bytes: int, unchanged: list[str]) -> str:
    same = f", {len(unchanged)} already there" if unchanged else ""
    return f"{files(len(copied))}, {decimal(size_bytes)}{same}"
