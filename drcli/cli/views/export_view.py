"""Shows what an export wrote."""

from typing import TYPE_CHECKING

from rich.filesize import decimal

from drcli.cli.views.layout import counted

if TYPE_CHECKING:
    from drcli.models.export_checkpoint import ExportReport


def reference(report: "ExportReport") -> str:
    size = f"{counted(len(report.files), 'file')}, {decimal(report.size_bytes)}"
    lines = [f"Exported {report.checkpoint} of {report.source} to {report.target}: {size}."]
    if report.archive is not None and report.archive != report.target:
        lines.append(f"The same files as an archive: {report.archive}")
    lines += [f"Note: {note}" for note in report.notes]
    lines += [f"Verified: {text}" for text in report.verified]
    lines += [f"Not verified: {text}" for text in report.not_verified]
    return "\n".join(lines)
