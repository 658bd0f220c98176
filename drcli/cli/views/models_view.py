"""Shows models, and what copying did."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.filesize import decimal
from rich.text import Text

from drcli.cli.views import notes_view
from drcli.cli.views.layout import Rows, counted, fitted

if TYPE_CHECKING:
    from drcli.model.model_list import CheckpointEntry, ModelList
    from drcli.transfer.copy_custom_files import CustomFilesReport
    from drcli.transfer.download import DownloadReport
    from drcli.transfer.upload import UploadIncrement, UploadReport

_WITH_TIME = 100
_DAY, _MINUTE = 10, 16
"""Characters of ISO 8601."""


def upload(report: "UploadReport") -> str:
    would = "Would upload" if report.dry_run else "Uploaded"
    lines = [f"{would} {report.checkpoint} of {_copied(report)}"]
    if report.deleted:
        verb = "would be deleted" if report.dry_run else "deleted"
        lines.append(f"{counted(len(report.deleted), 'file')} of earlier uploads {verb}.")
    if report.older:
        lines.append(
            f"Older checkpoints are kept: {len(report.older)}, {decimal(report.older_bytes)}; "
            "-w deletes them."
        )
    return "\n".join([*lines, *_replay(report)])


def download(report: "DownloadReport") -> str:
    lines = [f"{'Would download' if report.dry_run else 'Downloaded'} {_copied(report)}"]
    if not report.checkpoint:
        lines.append("It has no checkpoint yet, so it cannot drive.")
    if report.deleted:
        verb = "would be deleted" if report.dry_run else "deleted"
        lines.append(f"Not part of it and {verb}: {counted(len(report.deleted), 'file')}.")
    if report.strays:
        strays = counted(len(report.strays), "file")
        lines.append(f"Not part of it: {strays} at the target; -w deletes them.")
    wrote = (f"Wrote {path}" for path in report.custom_files)
    return "\n".join([*lines, *_replay(report), *wrote])


def _replay(report: "UploadReport | DownloadReport") -> list[str]:
    if not report.replay_bytes:
        return []
    return [
        f"Its replay buffer ({decimal(report.replay_bytes)}) is not copied: SAC goes on from the "
        "copy with an empty one, which costs some iterations."
    ]


def _copied(report: "UploadReport | DownloadReport") -> str:
    same = f", {len(report.unchanged)} already there" if report.unchanged else ""
    new = f"{counted(len(report.copied), 'file')}, {decimal(report.copied_bytes)}"
    return f"{report.source} to {report.target}: {new}{same}."


def upload_increment(step: "UploadIncrement") -> str:
    wiped = f" {counted(step.wiped, 'file')} deleted there." if step.wiped else ""
    return f"The next upload goes to {step.after}.{wiped}"


def custom_files(report: "CustomFilesReport", *, up: bool) -> str:
    place = report.place if up else report.folder
    unchanged = f", {len(report.unchanged)} unchanged" if report.unchanged else ""
    return "\n".join(
        [*report.copied, f"{counted(len(report.copied), 'file')} copied to {place}{unchanged}."]
    )


@fitted
def models(columns: int, found: "ModelList") -> RenderableType:
    if not found.models:
        matching = f" that matches {found.pattern}" if found.pattern else ""
        return f"There is no model in s3://{found.bucket}{matching}."
    digits = _MINUTE if columns >= _WITH_TIME else _DAY
    noted = any(model.note for model in found.models)
    rows: list[tuple[str | Text, ...]] = [
        (
            Text.assemble(
                model.prefix,
                (" (training)" if model.training else "", "green"),
                " (TensorFlow)" if model.kind == "tensorflow" else "",
            ),
            str(model.checkpoints),
            _checkpoint(model.best),
            _checkpoint(model.last),
            decimal(model.size_bytes),
            model.modified[:digits].replace("T", " "),
            *([notes_view.short(model.note)] if noted else []),
        )
        for model in found.models
    ]
    names = ("model", "ckpts", "best", "last", "size", "modified", *(["note"] if noted else []))
    title = Text(f"s3://{found.bucket}", style="bold")
    return Group(title, Rows(names, rows, left=("model", "modified", "note")))


def _checkpoint(entry: "CheckpointEntry | None") -> str:
    if entry is None:
        return "-"
    number = entry.name.partition("_")[0]
    told = entry.laps.partition(", slowest")[0] if entry.clean else entry.score
    return f"{number} ({told})" if told else number
