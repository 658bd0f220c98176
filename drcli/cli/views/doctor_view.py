"""Shows findings and support bundles."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drcli.cli.views.layout import counted

if TYPE_CHECKING:
    from drcli.checks.doctor.findings import DoctorReport
    from drcli.run.support_bundle import BundleReport

_STYLES = {"ok": "green", "warning": "yellow", "problem": "bold red"}


def findings(report: "DoctorReport") -> RenderableType:
    table = Table.grid(padding=(0, 1))
    table.add_column(no_wrap=True)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for finding in report.findings:
        text = Text(finding.text)
        if finding.remedy:
            text.append(f"\nTry: {finding.remedy}", style="bold")
        table.add_row(Text(finding.state, style=_STYLES[finding.state]), finding.subject, text)
    verdict = "No problems" if not report.problems else counted(report.problems, "problem")
    warnings = counted(report.warnings, "warning")
    end = Text(f"{verdict}, {warnings}, in {report.seconds:.1f} s.")
    return Group(Text(report.folder, style="bold"), table, end)


def bundle(report: "BundleReport") -> RenderableType:
    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_column(style="dim", no_wrap=True)
    for file in report.files:
        removed = f"{file.redactions:,} removed" if file.redactions else ""
        table.add_row(f"{file.size_bytes:,}", file.name, removed)
    known = counted(report.known_secrets, "known secret value")
    lines: list[RenderableType] = [table]
    if report.redactions:
        lines.append(Text("Removed:", style="bold"))
        lines += [Text(f"  {count:,} x {kind}") for kind, count in report.redactions.items()]
    else:
        lines.append(Text("Nothing had to be removed."))
    lines += [Text(f"Left out: {reason}", style="yellow") for reason in report.left_out]
    lines.append(Text(f"Searched again for {known}: none is in the archive."))
    lines.append(Text(f"Wrote {report.file} ({report.size_bytes:,} bytes).", style="bold"))
    return Group(*lines)
