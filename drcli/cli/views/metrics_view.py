"""Shows where figures go."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows, counted

if TYPE_CHECKING:
    from drcli.runs.tensorboard_server import MetricsReport


def metrics(report: "MetricsReport") -> RenderableType:
    parts: list[RenderableType] = []
    if report.url is not None:
        parts += [
            Text.assemble("TensorBoard: ", (report.url, "bold")),
            Text(f"Process {report.pid} shows {report.folder}.", "dim"),
        ]
    if report.fetched:
        brought = (
            f"Brought event files of {counted(len(report.fetched), 'model')} from the bucket: "
        )
        parts.append(Text(brought + ", ".join(report.fetched) + "."))
    if report.written:
        made = f"Made event files of {counted(len(report.written), 'model')}: "
        parts.append(Text(made + ", ".join(report.written) + "."))
    rows = [(tool.name, tool.setting, tool.place or "off") for tool in report.tools]
    parts += [
        Text("Figures of the next training go to:"),
        Rows(("tool", "setting", "place"), rows, left=("tool", "setting", "place")),
    ]
    return Group(*parts)
