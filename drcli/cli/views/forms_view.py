"""Shows exported policies."""

from typing import TYPE_CHECKING

from rich.filesize import decimal

if TYPE_CHECKING:
    from drcli.models.export_forms import FormReport


def exported(report: "FormReport") -> str:
    lines = [
        f"Exported {report.checkpoint} of {report.prefix} as {report.file}, "
        f"{decimal(report.size_bytes)}.",
        f"Compared with PyTorch on {report.frames} pictures (--runtime {report.engine}): "
        f"{report.same_actions:.1%} the same action, greatest difference "
        f"{report.greatest_difference:.1e}.",
    ]
    others = [file for file in report.files if file != report.file]
    return "\n".join([*lines, f"Beside it: {', '.join(others)}"])
