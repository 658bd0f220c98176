"""Shows what is deleted."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.filesize import decimal
from rich.text import Text

from drcli.cli.views.layout import Rows, counted

if TYPE_CHECKING:
    from drcli.transfer.model_removal import RemovalReport
    from drcli.transfer.tidy import TidyReport

KINDS = {
    "remains": "remains of a model",
    "damaged": "damaged objects",
    "rollouts": "recorded episodes",
    "traces": "traces",
    "checkpoints": "checkpoints",
    "logs": "local logs",
}


def planned(report: "RemovalReport") -> RenderableType:
    rows = [
        (
            model.prefix,
            str(model.checkpoints),
            str(model.objects),
            decimal(model.size_bytes),
            decimal(model.files_bytes) if model.files else "-",
            model.modified[:10],
        )
        for model in report.models
    ]
    names = ("model", "ckpts", "objects", "size", "local files", "modified")
    title = Text(f"s3://{report.bucket}", style="bold")
    total = Text(f"{counted(len(rows), 'model')}, {decimal(report.size_bytes)} in the bucket.")
    return Group(title, Rows(names, rows, left=("model", "modified")), total, *_records(report))


def _records(report: "RemovalReport") -> list[Text]:
    if not report.records:
        return []
    what = counted(report.records, "record")
    if report.forgotten:
        return [Text(f"Also {what} in dr-history.")]
    return [Text(f"{what} in dr-history will stay.")]


def removed(report: "RemovalReport") -> RenderableType:
    names = ", ".join(model.prefix for model in report.models)
    files = sum(len(model.files) for model in report.models)
    local = f" and {counted(files, 'local file')}" if files else ""
    objects = sum(model.objects for model in report.models)
    return Text(
        f"Deleted {names}: {counted(objects, 'object')}, {decimal(report.size_bytes)}{local}."
    )


def surplus(report: "TidyReport") -> RenderableType:
    left = _left_alone(report)
    if not report.items:
        return Group(Text(f"Nothing is left over in s3://{report.bucket}."), *left)
    rows = [
        (item.model, KINDS[item.kind], str(item.objects), decimal(item.size_bytes))
        for item in report.items
    ]
    names = ("model", "what", "objects", "size")
    title = Text(f"s3://{report.bucket}", style="bold")
    total = Text(f"Together {decimal(report.size_bytes)}.")
    return Group(title, Rows(names, rows, left=("model", "what")), total, *left)


def tidied(report: "TidyReport") -> RenderableType:
    objects = sum(item.objects for item in report.items)
    done = Text(f"Deleted {counted(objects, 'object')}, {decimal(report.size_bytes)}.")
    return Group(done, *_left_alone(report))


def _left_alone(report: "TidyReport") -> list[Text]:
    if not report.busy:
        return []
    return [Text(f"Left alone, because they are in use: {', '.join(report.busy)}.")]
