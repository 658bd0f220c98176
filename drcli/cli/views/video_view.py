"""Shows what a video holds."""

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows

if TYPE_CHECKING:
    from drcli.video.video_report import VideoReport


def video(report: "VideoReport") -> RenderableType:
    shown = f"{report.width}x{report.height}, {report.fps} frames per second"
    return Group(
        Text(f"{report.trace} on {report.world}", style="bold"),
        Rows(
            ("episode", "time", "progress", "ended"),
            [
                (
                    str(episode.episode),
                    f"{episode.seconds:.2f} s",
                    f"{episode.progress:.1f} %",
                    episode.text,
                )
                for episode in report.episodes
            ],
            left=("ended",),
        ),
        Text.assemble(f"Video of {report.seconds:.2f} s, {shown}: ", (report.file, "bold")),
    )
